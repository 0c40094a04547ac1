// FAST STOP: the button, the keys, and the results.

import { effect, html, signal } from '../lib.js';
import { ofProblem, t } from '../model/i18n.js';
import { fastStop, fastStopFleet, fastStopOne } from '../model/commands.js';
import { mustSignIn } from '../model/me.js';
import { find, grippers, hasOthers } from '../model/state.js';
import { get } from '../net/rest.js';
import { onPress } from './parts.js';
import { addNotices } from './strip.js';

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
  const gripper = find(name);
  return gripper?.isConfirmed.value === true && gripper.latchId.value >= id;
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

/** Whether the gateway refuses a FAST STOP without a sign-in. */
const needsSignIn = signal(false);

effect(() => {
  if (!mustSignIn.value) return;
  get('/healthz').then(
    ({ fast_stop: needs }) => {
      needsSignIn.value = needs === 'credential';
    },
    () => {},
  );
});

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
    const isStranger = problem.code === 'unauthorized' && mustSignIn.peek();
    if (isStranger) needsSignIn.value = true;
    report({
      text: of + (isStranger ? t('stop.refused') : t('stop.failed', { why: ofProblem(problem) })),
      isWrong: true,
    });
  }
}

export const stop = () => stopAndReport(fastStop, HERE, 'stop.here_count');

export const stopOne = (gripper) => stopAndReport(() => fastStopOne(gripper), gripper.name);

export const stopFleet = () => stopAndReport(fastStopFleet, FLEET, 'stop.fleet_count');

const STOP_KEYS = ['Escape', 'Pause'];

/**
 * Escape and Pause work in any view, also while the user types. A key that the browser keeps for itself, to close its find
 * bar, a menu or an open list, reaches the page as no `keydown`, and stops nothing.
 */
addEventListener(
  'keydown',
  (event) => {
    if (!STOP_KEYS.includes(event.key)) return;
    event.preventDefault();
    if (!event.repeat) stop();
  },
  { capture: true },
);

export function Stop() {
  if (needsSignIn.value && mustSignIn.value)
    return html`<p class="stop-place no-stop" id="no-stop">${t('stop.sign_in')}</p>`;
  const count = grippers.value.length;
  return html`<div class="stop-place">
    <button type="button" class="stop" id="stop" ...${onPress(stop)} aria-describedby="stop-note">
      <span class="stop-word">${t('stop.word')}</span><span
          class="stop-scope">${count === 0 ? t('stop.here') : t('stop.here_count', { count })} <kbd>Esc</kbd></span>
    </button>
    <p class="stop-note" id="stop-note">${t('stop.not')}</p>
  </div>`;
}

/** Ranks of the results among all notices: those that are not as wanted come first. */
const RANK = { wrong: 0, right: 10 };

addNotices(() =>
  [...results.value].reverse().map(([whom, { text, isWrong, note }]) => ({
    key: `stop/${whom}/${text}`,
    rank: isWrong ? RANK.wrong : RANK.right,
    kind: 'stop',
    isStop: true,
    tone: isWrong ? 'tone-critical' : '',
    shape: isWrong ? 'critical' : 'check',
    text: note ? `${text} ${note}` : text,
    close: () => change(whom, null),
    closeLabel: t('close'),
    closeName: text,
  })),
);
