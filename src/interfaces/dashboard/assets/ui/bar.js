// The permanent bar: link, state, holder of control, alarms, and STOP.

import { html } from '../lib.js';
import { isOpen, PRIORITIES } from '../core/alarms.js';
import { alarms } from '../model/alarms.js';
import { t, time } from '../model/i18n.js';
import { mustSignIn } from '../model/me.js';
import { connection, gripper, grippers, heardAt, isLive, selected } from '../model/store.js';
import { isOld } from '../model/version.js';
import { Shape, shapeOf, whyOld } from './parts.js';
import { go } from './route.js';
import { Results, Stop } from './stop.js';
import { Unknown, unknownText } from './unknown.js';

/** `why` is the reason that something is unknown. */
function Item({ label, shape, text, since, why, tone = '' }) {
  return html`<div class=${`status ${tone}`}><span class="status-label">${label}</span><span class="status-text">
    <${Shape} name=${shape} />${
      why
        ? html`<${Unknown} word=${text} why=${why} />`
        : html`<span title=${text}>${text}${since && html`<span class="since"> ${since}</span>`}</span>`
    }
  </span></div>`;
}

function linkItem(one) {
  // The gateway responds, but shows no states until the user has signed in.
  if (mustSignIn.value) return { shape: 'off', text: t('bar.sign_in') };
  if (connection.value !== 'live') {
    const since = heardAt.value && connection.value !== 'connecting' && t('bar.since', { time: time(heardAt.value) });
    return { shape: 'high', tone: 'tone-high', text: t(`bar.gateway.${connection.value}`), since };
  }
  const link = one?.link.value;
  if (!link) return { shape: 'off', text: '–' };
  return link === 'connected'
    ? { shape: 'on', text: t('link.connected') }
    : { shape: 'high', tone: 'tone-high', text: t(`link.${link}`) };
}

function stateItem(one) {
  if (!one) return { shape: 'off', text: t('bar.unknown') };
  const old = whyOld(one);
  if (old) return { shape: 'off', text: t('bar.unknown'), why: old.text };
  const state = one.condition.value;
  if (state === null) {
    const why = unknownText(one.state.value, 'flags') ?? unknownText(one.state.value, 'state');
    return { shape: 'off', text: t('bar.unknown'), why };
  }
  if (state === 'FAST_STOP') return { shape: 'critical', tone: 'tone-critical', text: t('state.FAST_STOP') };
  const tone = { ERROR: 'tone-critical', NO_PART: 'tone-high', PART_LOST: 'tone-high' }[state] ?? '';
  return { shape: one.isMoving.value ? 'moving' : tone ? 'high' : 'on', tone, text: t(`state.${state}`) };
}

function controlItem(one) {
  if (!isLive.value) return { shape: 'off', text: t('bar.unknown') };
  const holder = one?.holder.value;
  if (one?.isMine.value) return { shape: 'lock', tone: 'tone-mine', text: t('bar.mine') };
  const reserved = one?.reservedFor.value;
  if (reserved) return { shape: 'lock', tone: 'tone-high', text: t('bar.reserved', { name: reserved }) };
  return holder ? { shape: 'lock', text: holder } : { shape: 'off', text: t('bar.free') };
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

/** `notices` is the component that shows notices, once it is loaded. */
export function Bar({ notices }) {
  const one = gripper.value;
  return html`<header class="bar">
    <div class="bar-top">
      <h1 class="brand"><span class="brand-name">WSG Gateway</span> <span>${one?.name}</span></h1>
      <div class="statuses">
        <${Item} label=${t('bar.link')} ...${linkItem(one)} />
        <${Item} label=${t('bar.state')} ...${stateItem(one)} />
        <${Item} label=${t('bar.control')} ...${controlItem(one)} />
        <${Alarms} />
      </div>
      <${Stop} />
    </div>
    ${
      isOld.value &&
      html`<p class="newer" role="status">${t('newer')} <button type="button"
        onClick=${() => location.reload()}>${t('reload')}</button></p>`
    }
    ${notices && html`<${notices} />`}
    <${Results} />
  </header>`;
}

/** Above this number, grippers are offered in a list, so that all can be reached. */
const MAX_CHIPS = 8;

function stateText(one) {
  const old = whyOld(one);
  if (old) return old.text;
  return t(`state.${one.condition.value ?? 'unknown'}`);
}

function List({ all }) {
  return html`<select id="gripper-list" aria-label=${t('bar.grippers')} value=${selected.value}
      onChange=${({ currentTarget }) => {
        selected.value = currentTarget.value;
        go();
      }}>${all.map((one) => html`<option key=${one.name} value=${one.name}>${one.name} – ${stateText(one)}</option>`)}
    </select>`;
}

export function Picker() {
  const all = grippers.value;
  if (all.length > MAX_CHIPS) return html`<div class="picker"><${List} all=${all} /></div>`;
  return html`<nav class="picker" aria-label=${t('bar.grippers')}>
    ${all.map(
      (one) => html`<button type="button" key=${one.name} class="chip"
        aria-current=${one === gripper.value ? 'true' : 'false'} onClick=${() => {
          selected.value = one.name;
          go();
        }}>
      <${Shape} name=${shapeOf(one)} />${one.name}
        </button>`,
    )}
  </nav>`;
}
