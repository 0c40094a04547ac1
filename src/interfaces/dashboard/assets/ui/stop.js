// FAST STOP: the button, the keys, and the results.

import { effect, html, signal } from '../lib.js';
import { ofProblem, t } from '../model/i18n.js';
import { fastStop, fastStopFleet, fastStopOne } from '../model/commands.js';
import { find, grippers, hasOthers } from '../model/store.js';
import { onPress } from './parts.js';

/**
 * Results of FAST STOPs by the name of the gripper, `HERE` or `FLEET`: `{text, isWrong, note}`, with the `id` of a FAST
 * STOP that grippers have not confirmed, their names as `unconfirmed`, and `confirm()`, which shows that all of them
 * have confirmed it.
 */
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

const notConfirmed = (unconfirmed, id) => ({
  text: unconfirmed.length > 0 ? t('stop.unconfirmed', { grippers: unconfirmed.join(', ') }) : t('stop.out_of_reach'),
  isWrong: true,
  unconfirmed,
  id,
});

/** Whether a gripper of this gateway has confirmed this FAST STOP or a newer one. Ids grow with time. */
function hasConfirmed(name, id) {
  const one = find(name);
  return one?.isConfirmed.value === true && one.latchId.value >= id;
}

effect(() => {
  for (const [whom, result] of results.value) {
    const { unconfirmed = [], id } = result;
    const others = unconfirmed.filter((name) => !hasConfirmed(name, id));
    if (others.length === unconfirmed.length) continue;
    if (others.length === 0) result.confirm();
    else change(whom, { ...result, ...notConfirmed(others, id) });
  }
});

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
    const {
      fast_stop_confirmed: isConfirmed,
      fast_stop_id: id,
      gripper: name,
      confirmed = [],
      unconfirmed = [name],
    } = await sent;
    const ofFleet = results.peek().get(FLEET);
    const isPart = whom === HERE && hasOthers.peek() && (!ofFleet || ofFleet.isWrong);
    const note = isPart ? t('stop.not_others') : '';
    const count = confirmed.length + unconfirmed.length;
    const confirm = () => {
      report({ text: t('stop.confirmed', { reach: name ?? t(allText, { count }) }), note });
      setTimeout(() => report(null), CONFIRMATION_SHOWN_MS);
    };
    if (isConfirmed) confirm();
    else report({ ...notConfirmed(unconfirmed, id), note, confirm });
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

export function Stop() {
  const count = grippers.value.length;
  return html`<div class="stop-place">
    <button type="button" class="stop" id="stop" ...${onPress(stop)} aria-describedby="stop-note">
      <span class="stop-word">${t('stop.word')}</span><span
          class="stop-scope">${count === 0 ? t('stop.here') : t('stop.here_count', { count })} <kbd>Esc</kbd></span>
    </button>
    <p class="stop-note" id="stop-note">${t('stop.not')}</p>
  </div>`;
}

/** Results of FAST STOPs, the newest first. */
export function Results() {
  return html`<div class="results">${[...results.value].reverse().map(
    ([whom, { text, isWrong, note }]) => html`<p key=${whom} class=${`stopped ${isWrong ? 'tone-critical' : ''}`}
        role="status">${text} ${note}
      <button type="button" class="quiet" aria-label=${`${t('close')}: ${text}`}
        onClick=${() => change(whom, null)}>${t('close')}</button></p>`,
  )}</div>`;
}
