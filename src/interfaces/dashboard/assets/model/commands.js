// The user's requests, each with the lease that this page holds. A refusal is shown below the bar.

import { signal } from '../lib.js';
import { cut } from '../core/bytes.js';
import { postUrgently } from '../net/rest.js';
import { noConnection } from '../net/rpc.js';
import { holderName, myName } from './name.js';
import { onLossHolding, onLossMoving } from './prefs.js';
import { learn } from './reads.js';
import { rpc } from './wire.js';

/** Sends a request for a gripper. Resolves with the answer, or null if it was refused. */
export async function ask(gripper, method, params = {}) {
  gripper.problem.value = null;
  const lease = gripper.held.peek();
  try {
    return await rpc.call(method, {
      gripper: gripper.name,
      ...(lease && method !== 'lease' ? { lease: lease.token } : {}),
      ...params,
    });
  } catch (problem) {
    gripper.problem.value = problem;
    return null;
  }
}

/** Sends a request whose method takes no lease. */
export async function askFreely(gripper, method, params = {}) {
  gripper.problem.value = null;
  try {
    return await rpc.call(method, { gripper: gripper.name, ...params });
  } catch (problem) {
    gripper.problem.value = problem;
    return null;
  }
}

/** Time within which the state reports an admitted command. */
const REPORTED_WITHIN_MS = 300;

/** Starts a motion. The controls stay disabled until the state reports it. */
export async function move(gripper, method, params) {
  gripper.isMotionRequested.value = true;
  const command = await ask(gripper, method, params);
  if (command) gripper.command.value = command;
  setTimeout(
    () => {
      gripper.isMotionRequested.value = false;
    },
    command ? REPORTED_WITHIN_MS : 0,
  );
  return command;
}

export const terms = (holder = holderName.peek()) => ({
  holder: holder === '' ? undefined : holder,
  on_loss_moving: onLossMoving.peek(),
  on_loss_holding: onLossHolding.peek(),
});

/** Requests for control without an answer, as `NAME/request` or `NAME/take`. */
const taking = new Set();

/**
 * Takes control, once at a time: a second click sends no second request. Arguments are those of `requestControl`.
 */
export async function takeControl(gripper, options) {
  const what = `${gripper.name}/${options?.request ? 'request' : 'take'}`;
  if (taking.has(what)) return null;
  taking.add(what);
  try {
    return await requestControl(gripper, options);
  } finally {
    taking.delete(what);
  }
}

/**
 * Takes control for as long as this page answers. `force` takes it from another holder; `request` asks for it. `holder`
 * is the name under which this page asked for control, if the user has been renamed since.
 */
async function requestControl(gripper, { force = false, request = false, holder = holderName.peek() } = {}) {
  // Set before the request, because control can be handed over before the answer arrives.
  if (request) {
    gripper.controlRequest = { as: holder, at: performance.now(), epoch: gripper.newest.lease_epoch };
    gripper.isControlRequested.value = true;
  }
  const take = gripper.asking('lease');
  const lease = await askFreely(gripper, 'lease.take', { ...terms(holder), force, request });
  // Without a token in the reply, the request waits for the holder.
  if (lease?.token) {
    take(lease);
    gripper.own(lease);
  }
  const isFirst = lease?.place === 1;
  if (lease?.place && !isFirst) {
    gripper.problem.value = { code: 'lease_asked', holder: lease.requested_by, detail: '' };
  }
  if (request && !isFirst) gripper.isControlRequested.value = false;
  // Without an answer, the request can have reached the gateway.
  if (request && lease === null && gripper.problem.peek()?.code !== 'no_connection') gripper.controlRequest = null;
  return lease;
}

/** Takes back the control that this page had before it was loaded again. A lease that has ended meanwhile stays so. */
export async function resumeControl(gripper, token) {
  const take = gripper.asking('lease');
  const asked = { ...terms(), gripper: gripper.name, lease: token };
  const lease = await rpc.call('lease.take', asked).catch(() => null);
  if (!lease?.token) return;
  take(lease);
  gripper.own(lease);
}

/** Changes the terms of the lease that this page holds. */
export async function changeTerms(gripper, more = {}) {
  const held = gripper.held.peek();
  if (!held) return null;
  const take = gripper.asking('lease');
  const lease = await askFreely(gripper, 'lease.take', { ...terms(), lease: held.token, ...more });
  if (lease) take(lease);
  return lease;
}

export async function releaseControl(gripper) {
  const take = gripper.asking('lease');
  const epoch = gripper.held.peek()?.epoch;
  const released = ask(gripper, 'lease.release');
  gripper.epoch = null;
  const lease = await released;
  // Another person can have taken control on this page meanwhile.
  if (gripper.held.peek()?.epoch === epoch) gripper.own(null);
  if (lease) take(lease);
}

export async function handOver(gripper, to) {
  const take = gripper.asking('lease');
  const lease = await ask(gripper, 'lease.hand-over', { to });
  if (lease) {
    gripper.own(null);
    take(lease);
  } else {
    // The request can have ended.
    learn(gripper);
  }
}

/** Acknowledges the FAST STOP that is shown, and no other. */
export function acknowledge(gripper, id) {
  return askFreely(gripper, 'acknowledge', { fast_stop_id: id });
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

/** The newest FAST STOP that this page has sent: `{gripper}`, without a name if it is for all; null before the first. */
export const sentStop = signal(null);

async function sendFastStop(method, path, more = {}, fallsBackAfterMs = FALLS_BACK_AFTER_MS.here) {
  const name = myName.peek();
  const params = { reason: cut(name === '' ? 'dashboard' : `dashboard, ${name}`, MAX_REASON_BYTES) };
  const overSocket = rpc.call(method, { ...params, ...more }, STOPS_WITHIN_MS);
  sentStop.value = more;
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
