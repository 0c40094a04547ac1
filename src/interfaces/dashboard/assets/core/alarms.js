// Alarms: active, cleared and acknowledged. Pure functions, so that they can be tested.
//
// A cleared alarm stays in the list until it is acknowledged, so that no alarm is missed.

import { FLAGS, isSet } from './flags.js';
import { person } from './people.js';

/** Limit of the list. Active alarms are kept in any case. */
export const MAX_ALARMS = 100;

/** Highest first. */
export const PRIORITIES = ['critical', 'high', 'low'];

/** Returns the present faults of a gripper. Each fault keeps its key while it lasts. `lease` is null while unknown. */
export function wrongWith(state, lease = null) {
  const wrong = [];
  const add = (what, priority, cause = null) =>
    wrong.push({ key: `${state.gripper}/${what}`, gripper: state.gripper, what, priority, cause });
  if (state.fast_stop)
    add(`fast_stop/${state.fast_stop_id}`, 'critical', person(state.fast_stop_by, state.fast_stop_reason));
  if (state.link !== 'connected') add(`link/${state.link}`, 'high', state.link_cause);
  if (state.journal_cause) add('journal', 'high', state.journal_cause);
  for (const { bit, name, weight } of FLAGS) {
    if (name === 'FAST_STOP' || weight === 'normal' || !isSet(state.flags_raw, bit)) continue;
    add(`flag/${name}`, weight === 'fault' ? 'critical' : 'low');
  }
  if (state.state === 'PART_LOST') add('part_lost', 'high');
  // The client was lost while a part was held.
  if (lease?.reserved_for && state.lease_holder === null) add('reserved', 'high', lease.reserved_for);
  return wrong;
}

/** Fault of a lost or silent gateway. */
export const GATEWAY_GONE = { key: 'gateway', gripper: null, what: 'gateway', priority: 'high', cause: null };

/**
 * Returns the list for the faults `wrong` at `now`: new alarms come first, and ended ones are marked as cleared.
 * Cleared alarms are removed once acknowledged, and the oldest ones beyond the limit.
 */
export function updated(alarms, wrong, now) {
  const present = new Set(wrong.map(({ key }) => key));
  const active = new Set(alarms.filter((alarm) => !alarm.clearedAt).map(({ key }) => key));
  const begun = wrong
    .filter(({ key }) => !active.has(key))
    .map((one) => ({ ...one, id: `${one.key}@${now}`, since: now, clearedAt: null, acknowledgedAt: null }));
  const isOver = (alarm) => !alarm.clearedAt && !present.has(alarm.key);
  if (begun.length === 0 && !alarms.some(isOver)) return alarms;
  const kept = alarms.map((alarm) => (isOver(alarm) ? { ...alarm, clearedAt: now } : alarm));
  const all = [...begun, ...kept];
  const over = all.filter((alarm) => alarm.clearedAt && !alarm.acknowledgedAt);
  const dropped = new Set(over.slice(Math.max(0, MAX_ALARMS - present.size)));
  return all.filter((alarm) => !alarm.clearedAt || (!alarm.acknowledgedAt && !dropped.has(alarm)));
}

/** Returns the list after one alarm was acknowledged. */
export function acknowledged(alarms, id, now) {
  return alarms
    .map((alarm) => (alarm.id === id ? { ...alarm, acknowledgedAt: now } : alarm))
    .filter((alarm) => !alarm.clearedAt || !alarm.acknowledgedAt);
}

/** Sorts for display: unacknowledged alarms first, then active ones, each by priority and with the newest first. */
export function sorted(alarms) {
  const rank = (alarm) => (alarm.acknowledgedAt ? 2 : 0) + (alarm.clearedAt ? 1 : 0);
  return [...alarms].sort(
    (a, b) => rank(a) - rank(b) || PRIORITIES.indexOf(a.priority) - PRIORITIES.indexOf(b.priority) || b.since - a.since,
  );
}
