// The permanent bar: link, state, holder of control, alarms, and STOP.

import { html } from '../lib.js';
import { isOpen, PRIORITIES } from '../core/alarms.js';
import { alarms } from '../model/alarms.js';
import { t, time } from '../model/i18n.js';
import { mustSignIn } from '../model/me.js';
import { connection, shownGripper, grippers, heardAt, isLive, selected } from '../model/state.js';
import { Name, Shape, shapeOf, whyOld } from './parts.js';
import { isAcknowledged } from './result.js';
import { go } from './route.js';
import { Stop } from './stop.js';
import { Unknown, unknownText } from './unknown.js';

/** `why` is the reason that something is unknown. */
function Item({ label, shape, text, since, why, isName = false, tone = '' }) {
  return html`<div class=${`status ${tone}`}><span class="status-label">${label}</span><span class="status-text">
    <${Shape} name=${shape} />${
      why
        ? html`<${Unknown} word=${text} why=${why} />`
        : html`<span title=${text}>${isName ? html`<${Name} text=${text} />` : text}${since && html`<span class="since"> ${since}</span>`}</span>`
    }
  </span></div>`;
}

function linkItem(gripper) {
  // The gateway responds, but shows no states until the user has signed in.
  if (mustSignIn.value) return { shape: 'off', text: t('bar.sign_in') };
  if (connection.value !== 'live') {
    const since = heardAt.value && connection.value !== 'connecting' && t('bar.since', { time: time(heardAt.value) });
    return { shape: 'high', tone: 'tone-high', text: t(`bar.gateway.${connection.value}`), since };
  }
  const link = gripper?.link.value;
  if (!link) return { shape: 'off', text: '–' };
  return link === 'connected'
    ? { shape: 'on', text: t('link.connected') }
    : { shape: 'high', tone: 'tone-high', text: t(`link.${link}`) };
}

function stateItem(gripper) {
  if (!gripper) return { shape: 'off', text: t('bar.unknown') };
  const old = whyOld(gripper);
  if (old) return { shape: 'off', text: t('bar.unknown'), why: old.text };
  const state = gripper.condition.value;
  if (state === null) {
    const why = unknownText(gripper.state.value, 'flags') ?? unknownText(gripper.state.value, 'state');
    return { shape: 'off', text: t('bar.unknown'), why };
  }
  if (state === 'ERROR' && isAcknowledged(gripper)) return { shape: 'on', text: t('state.acknowledged') };
  if (state === 'FAST_STOP') return { shape: 'critical', tone: 'tone-critical', text: t('state.FAST_STOP') };
  const tone = { ERROR: 'tone-critical', NO_PART: 'tone-high', PART_LOST: 'tone-high' }[state] ?? '';
  return { shape: gripper.isMoving.value ? 'moving' : tone ? 'high' : 'on', tone, text: t(`state.${state}`) };
}

function controlItem(gripper) {
  if (!isLive.value) return { shape: 'off', text: t('bar.unknown') };
  const holder = gripper?.holder.value;
  if (gripper?.isMine.value) return { shape: 'lock', tone: 'tone-mine', text: t('bar.mine') };
  const reserved = gripper?.reservedFor.value;
  if (reserved) return { shape: 'lock', tone: 'tone-high', text: t('bar.reserved', { name: reserved }) };
  return holder ? { shape: 'lock', text: holder, isName: true } : { shape: 'off', text: t('bar.free') };
}

function Alarms() {
  const open = alarms.value.filter(isOpen);
  if (open.length === 0 && !isLive.value) {
    return html`<p class="alarm-badge"><${Shape} name="off" /><span>${t('bar.alarms_unknown')}</span></p>`;
  }
  const worst = PRIORITIES.find((priority) => open.some((alarm) => alarm.priority === priority));
  return html`<button type="button" class=${`alarm-badge ${worst ? `tone-${worst}` : ''}`}
      onClick=${() => {
        go('operate');
        requestAnimationFrame(() => document.getElementById('alarms')?.scrollIntoView());
      }}>
    <${Shape} name=${worst ?? 'check'} />
      <span>${
        open.length === 0
          ? t('bar.no_alarms')
          : t(open.length === 1 ? 'bar.alarm' : 'bar.alarms', { count: open.length })
      }</span>
  </button>`;
}

export function Bar() {
  const gripper = shownGripper.value;
  return html`<header class="bar">
    <h1 class="brand"><span class="brand-name">WSG Gateway</span> ${gripper && html`<${Name} text=${gripper.name} />`}</h1>
    <div class="statuses">
      <${Item} label=${t('bar.link')} ...${linkItem(gripper)} />
      <${Item} label=${t('bar.state')} ...${stateItem(gripper)} />
      <${Item} label=${t('bar.control')} ...${controlItem(gripper)} />
      <${Alarms} />
    </div>
    <${Stop} />
  </header>`;
}

/** Above this number, grippers are offered in a list, so that all can be reached. */
const MAX_CHIPS = 8;

function stateText(gripper) {
  const old = whyOld(gripper);
  if (old) return old.text;
  return t(`state.${gripper.condition.value ?? 'unknown'}`);
}

function List({ all }) {
  return html`<select id="gripper-list" aria-label=${t('bar.grippers')} value=${selected.value}
      onChange=${({ currentTarget }) => {
        selected.value = currentTarget.value;
        go();
      }}>${all.map((gripper) => html`<option key=${gripper.name} value=${gripper.name}>${gripper.name} – ${stateText(gripper)}</option>`)}
    </select>`;
}

export function Picker() {
  const all = grippers.value;
  if (all.length > MAX_CHIPS) return html`<div class="picker"><${List} all=${all} /></div>`;
  return html`<nav class="picker" aria-label=${t('bar.grippers')}>
    ${all.map(
      (gripper) => html`<button type="button" key=${gripper.name} class="chip"
        aria-current=${gripper === shownGripper.value ? 'true' : 'false'} onClick=${() => {
          selected.value = gripper.name;
          go();
        }}>
      <${Shape} name=${shapeOf(gripper)} /><${Name} text=${gripper.name} />
        </button>`,
    )}
  </nav>`;
}
