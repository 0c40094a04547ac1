// Measured values that are unknown. Pure functions, so that they can be tested.

/**
 * Returns why a value of a state is unknown, or null if it is known. `name` is as in `stale` of the API. The reasons are
 * `missing` (the gripper sends no valid value), `link` (no link to the gripper), `not_referenced` (the width before
 * homing) and `awaited` (no value yet).
 */
export function whyUnknown(state, name) {
  const value = name === 'flags' ? state.flags_raw : state[name];
  if (value !== null && value !== undefined) return null;
  if (state.stale.includes(name)) return 'missing';
  if (state.link !== 'connected') return 'link';
  return name === 'width_mm' && state.referenced === false ? 'not_referenced' : 'awaited';
}

/** Whether only the flags are missing: the gateway then refuses motions, although the gripper sends other values. */
export const lacksFlags = (state) =>
  state.link === 'unresponsive' && state.age_ms !== null && state.stale.includes('flags');

/** Matches the names in the cause of an alarm, such as `width_mm (not sent by the device), force_n (…)`. */
const NAMES = /(^|, )(\w+)(?= \()/g;

/** Names of the values in the cause of an alarm about unknown values. */
export const namesIn = (cause) => Array.from(cause.matchAll(NAMES), ([, , name]) => name);

/** The cause of an alarm about unknown values, with names replaced by `textOf(name)`. */
export const withNames = (cause, textOf) => cause.replace(NAMES, (_whole, before, name) => `${before}${textOf(name)}`);
