// The next step at a gripper. Pure functions, so that they can be tested.

/** States in which the last grip has failed. Firmware 4 then refuses another grip until the fingers were opened. */
const EMPTY_HANDED = ['NO_PART', 'PART_LOST'];

/** Steps that are motions. */
export const MOTION_STEPS = ['home', 'grip', 'release'];

/** Whether the gripper refuses a grip until it was released. */
export const mustRelease = (state, firmware) => EMPTY_HANDED.includes(state) && !(Number.parseInt(firmware, 10) < 4);

/**
 * Returns the one step that a person at this page does next: `wait` for a link, `acknowledge`, `flags` if the status is
 * unknown, `reserved` or `ask` if another client has or had control, `asked`, `take`, `steered` while a client steers the
 * fingers, `running`, `home`, `release` or `grip`.
 */
export function nextStep({
  isLive,
  link,
  isLatched,
  hasFlags,
  isMine,
  isMyReservation,
  reserved,
  holder,
  hasAsked,
  isSteered,
  runs,
  isReferenced,
  state,
}) {
  if (!isLive || link !== 'connected') return 'wait';
  if (isLatched) return 'acknowledge';
  if (!hasFlags) return 'flags';
  if (!isMine) {
    if (holder !== null) return hasAsked ? 'asked' : 'ask';
    return reserved !== null && !isMyReservation ? 'reserved' : 'take';
  }
  if (isSteered) return 'steered';
  if (runs) return 'running';
  if (!isReferenced) return 'home';
  return state === 'HOLDING' || EMPTY_HANDED.includes(state) ? 'release' : 'grip';
}
