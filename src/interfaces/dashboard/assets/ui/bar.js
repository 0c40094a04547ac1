// The permanent bar: link, state, holder of control, alarms, and STOP.

import { html, signal } from '../lib.js';
import { isOpen, PRIORITIES } from '../core/alarms.js';
import { alarms } from '../model/alarms.js';
import { ofProblem, t, time } from '../model/i18n.js';
import { fastStop, fastStopFleet, fastStopOne } from '../model/commands.js';
import { mustSignIn } from '../model/me.js';
import { connection, gripper, grippers, hasOthers, heardAt, isLive, selected } from '../model/store.js';
import { isOld } from '../model/version.js';
import { onPress, Shape, whyOld } from './parts.js';
import { go } from './route.js';

/** Results of FAST STOPs, `{text, isWrong, unconfirmed}`, by the name of the gripper, `HERE` or `FLEET`. */
const results = signal(new Map());
/** All grippers of this gateway, and of all gateways. No gripper has such a name. */
const [HERE, FLEET] = ['*', '**'];
/** The newest FAST STOP of each. Results of older ones are ignored. */
const newest = new Map();

function change(whom, result) {
  const changed = new Map(results.peek());
  if (result === null) changed.delete(whom);
  else changed.set(whom, result);
  results.value = changed;
}

const notConfirmed = (unconfirmed) => ({
  text: t('stop.unconfirmed', { grippers: unconfirmed.join(', ') }),
  isWrong: true,
  unconfirmed,
});

/** Takes a gripper out of the result for all grippers, which an own FAST STOP has overtaken. */
function noteConfirmed(name) {
  const { unconfirmed = [] } = results.peek().get(HERE) ?? {};
  if (!unconfirmed.includes(name)) return;
  const others = unconfirmed.filter((other) => other !== name);
  change(HERE, others.length === 0 ? null : notConfirmed(others));
}

/** Whether a FAST STOP of `whom` includes all of `other`. */
const includes = (whom, other) => whom === other || whom === FLEET || (whom === HERE && other !== FLEET);

function forgetWithin(whom) {
  for (const other of newest.keys()) {
    if (!includes(whom, other)) continue;
    newest.delete(other);
    change(other, null);
  }
}

/** Time for which a confirmation is shown. */
const CONFIRMATION_SHOWN_MS = 8000;

/** Shows the result of a FAST STOP of `whom`. `allText` names the number of all grippers that it reached. */
async function stopAndReport(send, whom, allText = null) {
  const mine = {};
  const report = (result) => {
    if (newest.get(whom) === mine) change(whom, result);
  };
  const of = allText === null ? `${whom}: ` : '';
  // The request is sent before the page changes.
  const sent = send();
  forgetWithin(whom);
  newest.set(whom, mine);
  report({ text: of + t('stop.sent') });
  try {
    // The answer for one gripper names it, and has no lists.
    const { fast_stop_confirmed: isConfirmed, gripper: name, confirmed, unconfirmed = [name] } = await sent;
    if (isConfirmed && allText === null) noteConfirmed(whom);
    const result = isConfirmed
      ? { text: t('stop.confirmed', { reach: name ?? t(allText, { count: confirmed.length }) }) }
      : notConfirmed(unconfirmed);
    const isPart = whom === HERE && hasOthers.peek() && !results.peek().has(FLEET);
    report(isPart ? { ...result, text: `${result.text} ${t('stop.not_others')}` } : result);
    if (isConfirmed) setTimeout(() => report(null), CONFIRMATION_SHOWN_MS);
  } catch (problem) {
    report({ text: of + t('stop.failed', { why: ofProblem(problem) }), isWrong: true });
  }
}

export const stop = () => stopAndReport(fastStop, HERE, 'stop.here_count');

export const stopOne = (one) => stopAndReport(() => fastStopOne(one), one.name);

export const stopFleet = () => stopAndReport(fastStopFleet, FLEET, 'stop.fleet_count');

const STOP_KEYS = ['Escape', 'Pause'];

/** Keys that are down. */
const down = new Set();

/** Escape and Pause work in any view, also while the user types. */
addEventListener(
  'keydown',
  (event) => {
    if (!STOP_KEYS.includes(event.key)) return;
    event.preventDefault();
    down.add(event.key);
    if (!event.repeat) stop();
  },
  { capture: true },
);

// An open list consumes the `keydown` event, so the page gets only the `keyup` event.
addEventListener(
  'keyup',
  ({ key }) => {
    if (STOP_KEYS.includes(key) && !down.delete(key)) stop();
  },
  { capture: true },
);
// The `keyup` event can go to another window.
addEventListener('blur', () => down.clear());

function Stop() {
  const count = grippers.value.length;
  return html`<div class="stop-place">
    <button type="button" class="stop" id="stop" ...${onPress(stop)} aria-describedby="stop-note">
      <span class="stop-word">${t('stop.word')}</span><span
          class="stop-scope">${count === 0 ? t('stop.here') : t('stop.here_count', { count })} <kbd>Esc</kbd></span>
    </button>
    <p class="stop-note" id="stop-note">${t('stop.not')}</p>
  </div>`;
}

function Item({ label, shape, text, tone = '' }) {
  return html`<div class=${`status ${tone}`}><span class="status-label">${label}</span><span class="status-text">
    <${Shape} name=${shape} /><span title=${text}>${text}</span></span></div>`;
}

function linkItem(one) {
  // The gateway responds, but shows no states until the user has signed in.
  if (mustSignIn.value) return { shape: 'off', text: t('bar.sign_in') };
  if (connection.value !== 'live') {
    const since =
      heardAt.value && connection.value !== 'connecting' ? ` ${t('bar.since', { time: time(heardAt.value) })}` : '';
    return { shape: 'high', tone: 'tone-high', text: t(`bar.gateway.${connection.value}`) + since };
  }
  const link = one?.link.value;
  if (!link) return { shape: 'off', text: '–' };
  return link === 'connected'
    ? { shape: 'on', text: t('link.connected') }
    : { shape: 'high', tone: 'tone-high', text: t(`link.${link}`) };
}

function stateItem(one) {
  if (!one || whyOld(one)) return { shape: 'off', text: t('bar.unknown') };
  if (one.latchId.value) return { shape: 'critical', tone: 'tone-critical', text: t('state.FAST_STOP') };
  const state = one.gripperState.value;
  if (!state) return { shape: 'off', text: '–' };
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
    <div class="results">${[...results.value].map(
      ([whom, { text, isWrong }]) => html`<p key=${whom} class=${`stopped ${isWrong ? 'tone-critical' : ''}`}
        role="status">${text}
      <button type="button" class="quiet" aria-label=${`${t('close')}: ${text}`}
        onClick=${() => change(whom, null)}>${t('close')}</button></p>`,
    )}</div>
  </header>`;
}

/** Above this number, grippers are offered in a list, so that all can be reached. */
const MAX_CHIPS = 8;

function stateText(one) {
  const old = whyOld(one);
  if (old) return old.text;
  return one.latchId.value ? t('state.FAST_STOP') : t(`state.${one.gripperState.value ?? 'unknown'}`);
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
      <${Shape} name=${whyOld(one) ? 'high' : one.latchId.value ? 'critical' : one.isMoving.value ? 'moving' : 'on'} />${one.name}
        </button>`,
    )}
  </nav>`;
}
