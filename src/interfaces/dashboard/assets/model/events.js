// Applies journal events to the page. They report the actions of all clients, on any interface.

import { batch } from '../lib.js';
import { isGrip } from '../core/kinds.js';
import { takeControl } from './commands.js';
import { noteJournalChange } from './journal.js';
import { takeRecipeChange } from './recipes.js';
import { ALL_SETTINGS, grippers, learn, learnSettings, others, read } from './store.js';

/** Limit of the clients in `others`. */
const MAX_OTHERS = 32;

function remember({ subject, label = null, door, at }) {
  const key = JSON.stringify([subject, label]);
  others.delete(key);
  others.set(key, { subject, label, door, at: Date.parse(at) });
  if (others.size > MAX_OTHERS) others.delete(others.keys().next().value);
}

function takeCommand(event, one, at) {
  const { command: kind, command_id: id } = event;
  if (event.phase === 'admitted') {
    const from = one.newest?.width_mm ?? null;
    const width = event.relative ? (from === null ? null : from + event.width_mm) : (event.width_mm ?? null);
    one.target.value = { command: id, kind, width_mm: width, force_n: event.force_n ?? null };
    one.command.value = { id, kind, phase: 'running', outcome: null, client: event.subject, started_at: event.at };
    if (isGrip(kind)) one.mark(at, 'begin', event.part_id ?? '');
    return;
  }
  const target = one.target.peek();
  const aim_mm = target?.command === id ? target.width_mm : null;
  if (target?.command === id) {
    // A grip's force stays set, so the device's value is read.
    if (target.force_n !== null) learnSettings(one, ['force-limit']);
    one.target.value = null;
  }
  one.command.value = { ...event, id, kind, aim_mm, client: event.subject };
  if (isGrip(kind)) one.mark(at, event.outcome === 'PART_HELD' ? 'held' : 'end', event.outcome);
}

/** Notes that another client took control from this page, or that the gateway ended this page's lease. */
function takeLoss({ event, holder, epoch, cause }, one) {
  if (event === 'forced' && epoch > one.epoch) one.loseControl('forced', holder);
  if (event === 'lost' && epoch === one.epoch) one.loseControl(cause === 'forbidden' ? cause : 'expired');
}

/** Ends this page's wait for control, and takes control if it was handed over to this page. */
function takeAnswer({ event, holder, epoch }, one) {
  // An event from before the request, or one that leaves the requests in their queue.
  if (epoch < one.controlRequest?.epoch || !['handed_over', 'released', 'lost'].includes(event)) return;
  one.isControlRequested.value = false;
  if (event === 'handed_over') takeHandedOver(one, holder);
  else one.controlRequest = null;
}

/** Takes control as `holder`, if that is the name under which this page has asked for it. */
async function takeHandedOver(one, holder) {
  if (holder !== one.controlRequest?.as) return;
  one.controlRequest = null;
  await takeControl(one, { holder });
}

function takeSetting(event, one) {
  one.askingSettings()(event.setting === 'soft_limits_cleared' ? { ...event, minus_mm: null, plus_mm: null } : event);
  // Without overdrive, the device reduces a force limit above the nominal force. No event reports this.
  if (event.setting === 'overdrive') learnSettings(one, ['force-limit']);
  if (event.setting === 'device_tag') learn(one);
}

/** Fetches what began or ended while the connection was lost. */
export function catchUp(one) {
  return Promise.all([catchUpCommand(one), catchUpAnswer(one)]);
}

async function catchUpAnswer(one) {
  const request = one.controlRequest;
  if (request === null) return;
  const { holder, requested_by: asks } = await read('lease', one);
  if (one.controlRequest !== request) return;
  if (asks !== request.as) one.isControlRequested.value = false;
  await takeHandedOver(one, holder);
}

async function catchUpCommand(one) {
  const runs = one.newest.command;
  if (one.target.peek()?.command !== runs) one.target.value = null;
  const shown = one.command.peek();
  const isOver = shown?.phase === 'running' && shown.id !== runs;
  if (runs !== null && shown?.id === runs) return;
  // Without a running one, the newest motion can have begun and ended meanwhile.
  const asked = runs === null ? read('command.latest', one) : read('command', one, { command: runs });
  const answer = await asked.catch(() => null);
  if (one.command.peek() !== shown) return;
  if (answer) one.command.value = answer;
  else if (isOver) one.command.value = { ...shown, phase: 'done', outcome: 'UNKNOWN' };
}

/** Reads again what the missed events may have changed; `subscribe` reads states and settings. */
export function takeGap() {
  takeRecipeChange();
  batch(() =>
    grippers.peek().forEach((one) => {
      one.changes.value += 1;
    }),
  );
}

/** Notes a new or changed grip record. `one` is undefined if this gateway no longer serves its gripper. */
export function takeGrip(one) {
  noteJournalChange();
  if (one) one.changes.value += 1;
}

/** Applies an event that arrived at `at`; `one` is its gripper, if any. */
export function takeEvent(event, one, at) {
  batch(() => {
    noteJournalChange();
    if (event.subject) remember(event);
    if (event.kind === 'recipe') takeRecipeChange();
    if (!one) return;
    if (event.kind === 'command' || event.kind === 'settings') one.changes.value += 1;
    if (event.kind === 'command') takeCommand(event, one, at);
    if (event.kind === 'settings') takeSetting(event, one);
    if (event.kind === 'lease') {
      takeLoss(event, one);
      learn(one);
      takeAnswer(event, one);
    }
    // The device may have been restarted, or be another one.
    if (event.kind === 'link' && event.link === 'connected')
      Promise.all([learn(one), learnSettings(one, ALL_SETTINGS)]);
  });
}
