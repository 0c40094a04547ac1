// What an event of the journal means for the page. All clients' doings come this way, whatever door they use.

import { batch } from '../lib.js';
import { takeControl } from './commands.js';
import { myName } from './name.js';
import { eventSeq, learn, learnSettings, others, rpc } from './store.js';

/** Names that are remembered. */
const MAX_OTHERS = 32;

function remember(subject, door, at) {
  others.delete(subject);
  others.set(subject, { door, at: Date.parse(at) });
  if (others.size > MAX_OTHERS) others.delete(others.keys().next().value);
}

function takeCommand(event, one, at) {
  const { command: kind, command_id: id } = event;
  if (event.phase === 'admitted') {
    const from = one.newest?.width_mm ?? null;
    const width = event.relative ? (from === null ? null : from + event.width_mm) : (event.width_mm ?? null);
    one.target.value = { command: id, kind, width_mm: width, force_n: event.force_n ?? null };
    one.command.value = { id, kind, phase: 'running', outcome: null, client: event.subject, started_at: event.at };
    if (kind === 'grip') one.mark(at, 'begin', event.part_id ?? '');
    return;
  }
  if (one.target.peek()?.command === id) {
    // A force that a grip came with stays set, as the device has it.
    if (one.target.peek().force_n !== null) learnSettings(one, ['force-limit']);
    one.target.value = null;
  }
  one.command.value = { ...event, id, kind, client: event.subject };
  if (kind === 'grip') one.mark(at, event.outcome === 'PART_HELD' ? 'held' : 'end', event.outcome);
}

/** Whoever has asked for control fetches it when it is handed over; whatever else becomes of it is no answer any more. */
function takeAnswer({ event, holder }, one) {
  if (event === 'requested') return;
  one.isAsking.value = false;
  if (event === 'handed_over' && holder === myName.peek()) takeControl(one);
}

function takeSetting(event, one) {
  one.takeSettings(event.setting === 'soft_limits_cleared' ? { ...event, minus_mm: null, plus_mm: null } : event);
  // Without overdrive a force limit above the nominal force is reduced, of which no event tells.
  if (event.setting === 'overdrive') learnSettings(one, ['force-limit']);
  one.settingsChange.value = event;
}

/** After a connection was lost: what began or ended meanwhile was told to nobody here. */
export function catchUp(one) {
  return Promise.all([catchUpCommand(one), catchUpAnswer(one)]);
}

async function catchUpAnswer(one) {
  if (!one.isAsking.peek()) return;
  const { holder, requested_by: asks } = await rpc.call('lease', { gripper: one.name });
  one.isAsking.value = asks === myName.peek();
  if (holder === myName.peek()) await takeControl(one);
}

async function catchUpCommand(one) {
  const runs = one.newest.command;
  if (one.target.peek()?.command !== runs) one.target.value = null;
  const shown = one.command.peek();
  const isOver = shown?.phase === 'running' && shown.id !== runs;
  if (!isOver && (runs === null || shown?.id === runs)) return;
  const told = await rpc.call('command', { gripper: one.name, command: runs ?? shown.id }).catch(() => null);
  if (one.command.peek() !== shown) return;
  if (told) one.command.value = told;
  else if (isOver) one.command.value = { ...shown, phase: 'done', outcome: 'UNKNOWN' };
}

/** Takes one that came at this time; `one` is its gripper, where it has one. */
export function take(event, one, at) {
  batch(() => {
    eventSeq.value = event.seq;
    if (event.subject) remember(event.subject, event.door, event.at);
    if (!one) return;
    if (event.kind === 'command') takeCommand(event, one, at);
    if (event.kind === 'settings') takeSetting(event, one);
    if (event.kind === 'lease') learn(one);
    if (event.kind === 'link' && event.link === 'connected') Promise.all([learn(one), learnSettings(one)]);
    if (event.kind === 'lease' && one.isAsking.peek()) takeAnswer(event, one);
  });
}
