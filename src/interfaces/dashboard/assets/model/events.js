// Applies journal events to the page. They report the actions of all clients, on any interface.

import { batch } from '../lib.js';
import { isGrip } from '../core/kinds.js';
import { takeControl } from './commands.js';
import { noteJournalChange } from './journal.js';
import { noteOutcome } from './outcomes.js';
import { takeRecipeChange } from './recipes.js';
import { ALL_SETTINGS, learn, learnSettings, read } from './reads.js';
import { takeServo } from './servo.js';
import { grippers, others } from './state.js';

/** Marks of the charts, by outcome. */
const MARKS = { PART_HELD: 'held', NO_PART: 'empty', WRONG_PART: 'wrong' };

/** Limit of the clients in `others`. */
const MAX_OTHERS = 32;

function remember({ subject, label = null, door, at }) {
  const key = JSON.stringify([subject, label]);
  others.delete(key);
  others.set(key, { subject, label, door, at: Date.parse(at) });
  if (others.size > MAX_OTHERS) others.delete(others.keys().next().value);
}

function takeCommand(event, gripper, at) {
  const { command: kind, command_id: id } = event;
  if (event.phase === 'admitted') {
    const from = gripper.newest?.width_mm ?? null;
    const width = event.relative ? (from === null ? null : from + event.width_mm) : (event.width_mm ?? null);
    gripper.target.value = { command: id, kind, width_mm: width, force_n: event.force_n ?? null };
    gripper.command.value = { id, kind, phase: 'running', outcome: null, client: event.subject, started_at: event.at };
    if (isGrip(kind)) {
      gripper.mark(at, 'begin', event.part_id ?? '');
      gripper.part.value = event.part_id ?? null;
    }
    return;
  }
  const target = gripper.target.peek();
  const aim_mm = target?.command === id ? target.width_mm : null;
  if (target?.command === id) {
    // A grip's force stays set, so the device's value is read.
    if (target.force_n !== null) learnSettings(gripper, ['force-limit']);
    gripper.target.value = null;
  }
  gripper.command.value = { ...event, id, kind, aim_mm, client: event.subject };
  if (isGrip(kind)) gripper.mark(at, MARKS[event.outcome] ?? 'end', event.outcome);
}

/** Notes that another client took control from this page, or that the gateway ended this page's lease. */
function takeLoss({ event, holder, epoch, cause }, gripper) {
  if (event === 'forced' && epoch > gripper.epoch) gripper.loseControl('forced', holder);
  if (event === 'lost' && epoch === gripper.epoch) gripper.loseControl(cause === 'forbidden' ? cause : 'expired');
}

/** Ends this page's wait for control, and takes control if it was handed over to this page. */
function takeAnswer({ event, holder, epoch }, gripper) {
  // An event from before the request, or one that leaves the requests in their queue.
  if (epoch < gripper.controlRequest?.epoch || !['handed_over', 'released', 'lost'].includes(event)) return;
  gripper.isControlRequested.value = false;
  if (event === 'handed_over') takeHandedOver(gripper, holder);
  else gripper.controlRequest = null;
}

/** Takes control as `holder`, if that is the name under which this page has asked for it. */
async function takeHandedOver(gripper, holder) {
  if (holder !== gripper.controlRequest?.as) return;
  gripper.controlRequest = null;
  await takeControl(gripper, { holder });
}

function takeSetting(event, gripper) {
  gripper.askingSettings()(
    event.setting === 'soft_limits_cleared' ? { ...event, minus_mm: null, plus_mm: null } : event,
  );
  // Without overdrive, the device reduces a force limit above the nominal force. No event reports this.
  if (event.setting === 'overdrive') learnSettings(gripper, ['force-limit']);
  if (event.setting === 'device_tag') learn(gripper);
}

/** Fetches what began or ended while the connection was lost. */
export function catchUp(gripper) {
  return Promise.all([catchUpCommand(gripper), catchUpAnswer(gripper)]);
}

async function catchUpAnswer(gripper) {
  const request = gripper.controlRequest;
  if (request === null) return;
  const { holder, requested_by: asks } = await read('lease', gripper);
  if (gripper.controlRequest !== request) return;
  if (asks !== request.as) gripper.isControlRequested.value = false;
  await takeHandedOver(gripper, holder);
}

async function catchUpCommand(gripper) {
  const runs = gripper.newest.command;
  if (gripper.target.peek()?.command !== runs) gripper.target.value = null;
  const shown = gripper.command.peek();
  const isOver = shown?.phase === 'running' && shown.id !== runs;
  if (runs !== null && shown?.id === runs) return;
  // Without a running one, the newest motion can have begun and ended meanwhile.
  const asked = runs === null ? read('command.latest', gripper) : read('command', gripper, { command: runs });
  const answer = await asked.catch(() => null);
  if (gripper.command.peek() !== shown) return;
  if (answer) gripper.command.value = answer;
  else if (isOver) gripper.command.value = { ...shown, phase: 'done', outcome: 'UNKNOWN' };
}

/** Reads again what the missed events may have changed; `subscribe` reads states and settings. */
export function takeGap() {
  takeRecipeChange();
  batch(() =>
    grippers.peek().forEach((gripper) => {
      gripper.changes.value += 1;
    }),
  );
}

/** Notes a new or changed grip record. `gripper` is undefined if this gateway no longer serves its gripper. */
export function takeGrip(grip, gripper) {
  noteJournalChange();
  if (!gripper) return;
  gripper.changes.value += 1;
  noteOutcome(gripper, grip);
}

/** Applies an event that arrived at `at`; `gripper` is its gripper, if any. */
export function takeEvent(event, gripper, at) {
  batch(() => {
    noteJournalChange();
    if (event.subject) remember(event);
    if (event.kind === 'recipe') takeRecipeChange();
    if (!gripper) return;
    if (event.kind === 'command' || event.kind === 'settings') gripper.changes.value += 1;
    if (event.kind === 'command') takeCommand(event, gripper, at);
    if (event.kind === 'settings') takeSetting(event, gripper);
    if (event.kind === 'device') takeServo(event, gripper);
    if (event.kind === 'lease') {
      takeLoss(event, gripper);
      learn(gripper);
      takeAnswer(event, gripper);
    }
    // The device may have been restarted, or be another one.
    if (event.kind === 'link' && event.link === 'connected')
      Promise.all([learn(gripper), learnSettings(gripper, ALL_SETTINGS)]);
  });
}
