// The user's requests, each with the lease that this page holds. A refusal is shown below the bar.

import { cut } from '../core/bytes.js';
import { postUrgently } from '../net/rest.js';
import { noConnection } from '../net/rpc.js';
import { myName } from './name.js';
import { onLossHolding, onLossMoving } from './prefs.js';
import { learn, rpc } from './store.js';

/** Sends a request for a gripper. Resolves with the answer, or null if it was refused. */
export async function ask(one, method, params = {}) {
  one.problem.value = null;
  const lease = one.held.peek();
  try {
    return await rpc.call(method, {
      gripper: one.name,
      ...(lease && method !== 'lease' ? { lease: lease.token } : {}),
      ...params,
    });
  } catch (problem) {
    one.problem.value = problem;
    return null;
  }
}

/** Sends a request whose method takes no lease. */
export async function askFreely(one, method, params = {}) {
  one.problem.value = null;
  try {
    return await rpc.call(method, { gripper: one.name, ...params });
  } catch (problem) {
    one.problem.value = problem;
    return null;
  }
}

/** Time within which the state reports an admitted command. */
const REPORTED_WITHIN_MS = 300;

/** Starts a motion. The controls stay disabled until the state reports it. */
export async function move(one, method, params) {
  one.isMotionRequested.value = true;
  const command = await ask(one, method, params);
  if (command) one.command.value = command;
  setTimeout(
    () => {
      one.isMotionRequested.value = false;
    },
    command ? REPORTED_WITHIN_MS : 0,
  );
  return command;
}

export const terms = (holder = myName.peek()) => ({
  holder,
  on_loss_moving: onLossMoving.peek(),
  on_loss_holding: onLossHolding.peek(),
});

/**
 * Takes control for as long as this page answers. `force` takes it from another holder; `request` asks for it. `holder`
 * is the name under which this page asked for control, if the user has been renamed since.
 */
export async function takeControl(one, { force = false, request = false, holder = myName.peek() } = {}) {
  // Set before the request, because control can be handed over before the answer arrives.
  if (request) {
    one.controlRequest = { as: holder, at: performance.now(), epoch: one.newest.lease_epoch };
    one.isControlRequested.value = true;
  }
  const take = one.asking('lease');
  const lease = await askFreely(one, 'lease.take', { ...terms(holder), force, request });
  // Without a token in the reply, the request waits for the holder.
  if (lease?.token) {
    take(lease);
    one.own(lease);
  }
  const isFirst = lease?.place === 1;
  if (lease?.place && !isFirst) {
    one.problem.value = { code: 'lease_asked', holder: lease.requested_by, detail: '' };
  }
  if (request && !isFirst) one.isControlRequested.value = false;
  // Without an answer, the request can have reached the gateway.
  if (request && lease === null && one.problem.peek()?.code !== 'no_connection') one.controlRequest = null;
  return lease;
}

/** Changes the terms of the lease that this page holds. */
export async function changeTerms(one, more = {}) {
  const held = one.held.peek();
  if (!held) return null;
  const take = one.asking('lease');
  const lease = await askFreely(one, 'lease.take', { ...terms(), lease: held.token, ...more });
  if (lease) take(lease);
  return lease;
}

export async function releaseControl(one) {
  const take = one.asking('lease');
  const epoch = one.held.peek()?.epoch;
  const released = ask(one, 'lease.release');
  one.epoch = null;
  const lease = await released;
  // Another person can have taken control on this page meanwhile.
  if (one.held.peek()?.epoch === epoch) one.own(null);
  if (lease) take(lease);
}

export async function handOver(one, to) {
  const take = one.asking('lease');
  const lease = await ask(one, 'lease.hand-over', { to });
  if (lease) {
    one.own(null);
    take(lease);
  } else {
    // The request can have ended.
    learn(one);
  }
}

/** Acknowledges the FAST STOP that is shown, and no other. */
export function acknowledge(one, id) {
  return askFreely(one, 'acknowledge', { fast_stop_id: id });
}

/**
 * Times without a reply on the WebSocket after which a FAST STOP is also sent as an HTTP request. The time for the
 * fleet is longer, because other gateways have 500 ms to confirm.
 */
const FALLS_BACK_AFTER_MS = { here: 300, fleet: 700 };
/** Time after which a FAST STOP is reported as failed. */
const STOPS_WITHIN_MS = 3000;
/** The gateway's limit of a reason. */
const MAX_REASON_BYTES = 64;

async function sendFastStop(method, path, more = {}, fallsBackAfterMs = FALLS_BACK_AFTER_MS.here) {
  const params = { reason: cut(`dashboard, ${myName.peek()}`, MAX_REASON_BYTES) };
  const overSocket = rpc.call(method, { ...params, ...more }, STOPS_WITHIN_MS);
  const late = new Promise((_, reject) => {
    setTimeout(() => reject(noConnection()), fallsBackAfterMs);
  });
  try {
    return await Promise.race([overSocket, late]);
  } catch {
    // A second FAST STOP is better than none.
    return Promise.any([overSocket, postUrgently(path, params, myName.peek(), STOPS_WITHIN_MS)]).catch((both) => {
      throw both.errors.at(-1);
    });
  }
}

/** Sends a FAST STOP to all grippers of this gateway. */
export const fastStop = () => sendFastStop('fast-stop', 'fast-stop');

/** Sends a FAST STOP to the grippers of all gateways. */
export const fastStopFleet = () => sendFastStop('fleet.fast-stop', 'fleet/fast-stop', {}, FALLS_BACK_AFTER_MS.fleet);

/** Sends a FAST STOP to one gripper. */
export const fastStopOne = ({ name }) => sendFastStop('fast-stop', `grippers/${name}/fast-stop`, { gripper: name });
