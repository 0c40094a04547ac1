// The state of the page's connection: `connecting` at first, then `live`, `silent` or `lost`. A pure function, so that it
// can be tested.

/** Silence after which the shown values count as old; the page must say so within 2 s. */
export const STALE_AFTER_MS = 1200;

/**
 * Returns the state after `silenceMs` without a message on this connection. An open connection on which no message has
 * arrived changes nothing.
 */
export function connectionAfter(before, isOpen, silenceMs) {
  if (isOpen && silenceMs <= STALE_AFTER_MS) return 'live';
  if (before === 'connecting') return 'connecting';
  return isOpen && before !== 'lost' ? 'silent' : 'lost';
}
