// The gateway's clock. The clock of a panel can be wrong, so ages are computed from the gateway's times.

/** Time after which a later estimate replaces an earlier one, because a clock can be set. */
const RENEWED_AFTER_MS = 10_000;

/** Correction of this machine's clock, estimated at `estimatedAt`. */
let offsetMs = null;
let estimatedAt = 0;

/** Time of the gateway, in ms since 1970; that of this machine until the gateway's is known. */
export const gatewayNow = () => Date.now() + (offsetMs ?? 0);

/** Notes a time of the gateway that has just passed. Messages are late, never early: the largest estimate is the best. */
export function noteTime(at, now = Date.now()) {
  const estimate = Date.parse(at) - now;
  if (Number.isNaN(estimate)) return;
  if (offsetMs !== null && estimate <= offsetMs && now - estimatedAt < RENEWED_AFTER_MS) return;
  offsetMs = estimate;
  estimatedAt = now;
}
