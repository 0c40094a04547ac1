// Requests for control, which the gateway keeps for a minute.

import { terms } from './commands.js';
import { learn } from './reads.js';
import { rpc } from './wire.js';

const REPEATED_EVERY_MS = 20_000;

/** Time after which a person no longer expects control. Then the request is not repeated. */
const WAITS_MS = 10 * 60_000;

/** The gateway's limit of a request that is not repeated. */
const KEPT_MS = 60_000;

/** Time of the newest look at each gripper. */
const lookedAt = new WeakMap();

/** Repeats this page's request for control, without a word to the user: events report its result. */
async function repeat(gripper) {
  const take = gripper.asking('lease');
  const asked = { ...terms(gripper.controlRequest.as), gripper: gripper.name, request: true };
  const lease = await rpc.call('lease.take', asked).catch(() => null);
  if (!lease?.token) return;
  take(lease);
  gripper.own(lease);
}

/**
 * To be called with each state of a gripper. On a hidden page, states arrive every second, but timers can run only once
 * a minute.
 */
export function keepAsking(gripper) {
  const now = performance.now();
  if (now - (lookedAt.get(gripper) ?? -Infinity) < REPEATED_EVERY_MS) return;
  lookedAt.set(gripper, now);
  const waited = now - (gripper.controlRequest?.at ?? -Infinity);
  if (waited >= WAITS_MS) gripper.isControlRequested.value = false;
  if (waited >= WAITS_MS + KEPT_MS) gripper.controlRequest = null;
  // Without a holder, a request would take control at once, although the user may be away.
  if (gripper.isControlRequested.peek() && gripper.newest.lease_holder !== null) repeat(gripper);
  // No event reports that another client's request has ended.
  else if (gripper.lease.peek()?.requested_by) learn(gripper);
}
