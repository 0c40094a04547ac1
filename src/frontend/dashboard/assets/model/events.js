// What an event of the journal means for the page. All clients' doings come this way, whatever door they use.

import { batch } from '../lib.js';
import { myName } from './prefs.js';
import { eventSeq, learn, others } from './store.js';

/** Names that are remembered. */
const MAX_OTHERS = 32;

function remember(subject, door, at) {
  const next = new Map(others.peek());
  next.delete(subject);
  next.set(subject, { door, at: Date.parse(at) });
  while (next.size > MAX_OTHERS) next.delete(next.keys().next().value);
  others.value = next;
}

function takeCommand(event, one) {
  const { command: kind, command_id: id } = event;
  if (event.phase === 'admitted') {
    const from = one.newest?.width_mm ?? null;
    const width = event.relative ? (from === null ? null : from + event.width_mm) : event.width_mm ?? null;
    one.target.value = { command: id, kind, width_mm: width };
    one.command.value = { id, kind, phase: 'running', outcome: null, client: event.subject, started_at: event.at };
    if (kind === 'grip') one.mark(performance.now(), 'begin', event.part_id ?? '');
    return;
  }
  if (one.target.peek()?.command === id) one.target.value = null;
  one.command.value = { ...event, id, kind, client: event.subject };
  if (kind === 'grip') one.mark(performance.now(), event.outcome === 'PART_HELD' ? 'held' : 'end', event.outcome);
}

/** Whoever has asked for control fetches it when it is handed over; whatever else becomes of it is no answer any more. */
function takeAnswer({ event, holder }, one) {
  if (event === 'requested') return;
  one.isAsking.value = event === 'handed_over' && holder === myName.peek() ? 'come' : false;
}

/** Takes one; `one` is its gripper, where it has one. */
export function take(event, one) {
  batch(() => {
    eventSeq.value = event.seq;
    if (event.subject) remember(event.subject, event.door, event.at);
    if (!one) return;
    if (event.kind === 'command') takeCommand(event, one);
    const changes = event.kind === 'lease' || event.kind === 'settings' || (event.kind === 'link' && event.link === 'connected');
    if (changes) learn(one);
    if (event.kind === 'lease' && one.isAsking.peek()) takeAnswer(event, one);
  });
}
