// The gateway's alarms, and the one that only this page can raise. Pure functions, so that they can be tested.

/** Highest first. */
export const PRIORITIES = ['critical', 'high', 'low'];

export const isOpen = (alarm) => alarm.acknowledged_at === null;

export const isActive = (alarm) => alarm.ended_at === null;

/** Returns this page's alarm of a lost or silent gateway, or null: it stays until it has ended and is acknowledged. */
export function noGateway(before, isGone, at) {
  if (isGone && (before === null || !isActive(before))) {
    return {
      id: 'no_gateway',
      alarm: 'no_gateway',
      priority: 'high',
      gripper: null,
      gateway: null,
      cause: null,
      began_at: at,
      ended_at: null,
      count: 1,
      acknowledged_at: null,
      acknowledged_by: null,
    };
  }
  if (isGone || before === null || !isActive(before)) return before;
  return isOpen(before) ? { ...before, ended_at: at } : null;
}

/** Returns this page's alarm after its acknowledgement. */
export const acknowledged = (alarm, at) => (isActive(alarm) ? { ...alarm, acknowledged_at: at } : null);

/** Sorts for display: unacknowledged alarms first, then active ones, each by priority, age (newest first) and name. */
export function sorted(alarms) {
  const rank = (alarm) => (isOpen(alarm) ? 0 : 2) + (isActive(alarm) ? 0 : 1);
  const byName = (a, b) => (a.gripper ?? '').localeCompare(b.gripper ?? '', 'en', { numeric: true });
  return [...alarms].sort(
    (a, b) =>
      rank(a) - rank(b) ||
      PRIORITIES.indexOf(a.priority) - PRIORITIES.indexOf(b.priority) ||
      Date.parse(b.began_at) - Date.parse(a.began_at) ||
      byName(a, b),
  );
}
