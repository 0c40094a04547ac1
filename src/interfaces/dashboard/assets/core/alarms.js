// Alarms: what is wrong now, what was and is over, and what somebody has seen. Pure, so that it can be tested.
//
// An alarm that is over stays in the list until it is acknowledged: what happened while nobody looked is not lost.

import { FLAGS, isSet } from './flags.js';

/** As many are kept as somebody reads; what is wrong now in any case. */
export const MAX_ALARMS = 100;

/** Priorities, the highest first. */
export const PRIORITIES = ['critical', 'high', 'low'];

/** What is wrong with a gripper, by a key that stays the same for as long as it is. */
export function wrongWith(state) {
  const wrong = [];
  const add = (what, priority, cause = null) =>
    wrong.push({ key: `${state.gripper}/${what}`, gripper: state.gripper, what, priority, cause });
  if (state.fast_stop) add(`fast_stop/${state.fast_stop_id}`, 'critical', state.fast_stop_by);
  if (state.link !== 'connected') add(`link/${state.link}`, 'high', state.link_cause);
  if (state.journal_cause) add('journal', 'high', state.journal_cause);
  for (const { bit, name, weight } of FLAGS) {
    if (name === 'FAST_STOP' || weight === 'normal' || !isSet(state.flags_raw, bit)) continue;
    add(`flag/${name}`, weight === 'fault' ? 'critical' : 'low');
  }
  if (state.state === 'PART_LOST') add('part_lost', 'high');
  return wrong;
}

/** What is wrong with the way to the gateway, of which nothing else is known then. */
export const GATEWAY_GONE = { key: 'gateway', gripper: null, what: 'gateway', priority: 'high', cause: null };

/**
 * The list after `wrong` was seen at `now`: new alarms first, those that are over marked, the oldest of those that are
 * over and acknowledged left out.
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

/** The list after somebody has seen one. */
export function acknowledged(alarms, id, now) {
  return alarms
    .map((alarm) => (alarm.id === id ? { ...alarm, acknowledgedAt: now } : alarm))
    .filter((alarm) => !alarm.clearedAt || !alarm.acknowledgedAt);
}

/** As people look for them: what is not acknowledged, then what is wrong now, each by priority and age. */
export function sorted(alarms) {
  const rank = (alarm) => (alarm.acknowledgedAt ? 2 : 0) + (alarm.clearedAt ? 1 : 0);
  return [...alarms].sort(
    (a, b) => rank(a) - rank(b) || PRIORITIES.indexOf(a.priority) - PRIORITIES.indexOf(b.priority) || b.since - a.since,
  );
}
