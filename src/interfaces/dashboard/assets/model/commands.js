// What people ask for: each request with the lease that this page holds, and what is refused shown beside its control.

import { cut } from '../core/bytes.js';
import { postUrgently } from '../net/rest.js';
import { noConnection } from '../net/rpc.js';
import { myName } from './name.js';
import { onLossHolding, onLossMoving } from './prefs.js';
import { rpc } from './store.js';

/** A request on a gripper. Resolves with its answer, or null where it was refused. */
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

/** A request whose method knows no lease. */
export async function askFreely(one, method, params = {}) {
  one.problem.value = null;
  try {
    return await rpc.call(method, { gripper: one.name, ...params });
  } catch (problem) {
    one.problem.value = problem;
    return null;
  }
}

/** By then the state tells of a command that was admitted. */
const TOLD_WITHIN_MS = 300;

/** A motion. Until the state tells of it nothing else is asked for. */
export async function move(one, method, params) {
  one.isAsked.value = true;
  const command = await ask(one, method, params);
  if (command) one.command.value = command;
  setTimeout(
    () => {
      one.isAsked.value = false;
    },
    command ? TOLD_WITHIN_MS : 0,
  );
  return command;
}

const terms = () => ({
  holder: myName.peek(),
  on_loss_moving: onLossMoving.peek(),
  on_loss_holding: onLossHolding.peek(),
});

/** Takes control: it lives as long as this page answers. Of somebody else's by `force`, or by asking with `request`. */
export async function takeControl(one, { force = false, request = false } = {}) {
  // Before it is asked: the answer may be handed over sooner than it is told that there is to be one.
  if (request) one.isAsking.value = true;
  const lease = await askFreely(one, 'lease.take', { ...terms(), force, request });
  if (lease) {
    one.lease.value = lease;
    one.held.value = { token: lease.token, epoch: lease.epoch };
  }
  if (request && one.problem.peek()?.code === 'lease_held') await lookWhoAsks(one);
  else one.isAsking.value = false;
  return lease;
}

/** Of several who ask the first is told to the holder: whoever is another one isn't asking. */
async function lookWhoAsks(one) {
  const told = await askFreely(one, 'lease');
  const me = myName.peek();
  if (!told || !one.isAsking.peek() || told.requested_by === me || told.holder === me) return;
  one.isAsking.value = false;
  one.problem.value = { code: 'lease_asked', holder: told.requested_by, detail: '' };
}

/** Other terms for what is held already. */
export async function changeTerms(one, more = {}) {
  const held = one.held.peek();
  if (!held) return null;
  const lease = await askFreely(one, 'lease.take', { ...terms(), lease: held.token, ...more });
  if (lease) one.lease.value = lease;
  return lease;
}

export async function releaseControl(one) {
  const lease = await ask(one, 'lease.release');
  one.held.value = null;
  if (lease) one.lease.value = lease;
}

export async function handOver(one, to) {
  const lease = await ask(one, 'lease.hand-over', { to });
  if (lease) {
    one.held.value = null;
    one.lease.value = lease;
  }
}

/** Nothing but the FAST STOP that is shown is acknowledged. */
export function acknowledge(one, id) {
  return askFreely(one, 'acknowledge', { fast_stop_id: id });
}

/** A stop that waits for no connection: by the WebSocket, and where that doesn't answer at once by a request of its own. */
const FALLS_BACK_AFTER_MS = 300;
/** Then it has failed, and it is said. */
const STOPS_WITHIN_MS = 3000;
/** The gateway keeps so much of a reason. */
const MAX_REASON_BYTES = 64;

export async function fastStop(gripperName = null) {
  const params = { reason: cut(`dashboard, ${myName.peek()}`, MAX_REASON_BYTES) };
  const path = gripperName ? `grippers/${gripperName}/fast-stop` : 'fast-stop';
  const overSocket = rpc.call('fast-stop', gripperName ? { ...params, gripper: gripperName } : params, STOPS_WITHIN_MS);
  const late = new Promise((_, reject) => {
    setTimeout(() => reject(noConnection()), FALLS_BACK_AFTER_MS);
  });
  try {
    return await Promise.race([overSocket, late]);
  } catch {
    // Two stops are one stop too many, and none is one too few.
    return Promise.any([overSocket, postUrgently(path, params, STOPS_WITHIN_MS)]).catch((both) => {
      throw both.errors.at(-1);
    });
  }
}

/** The same for one gripper; what became of the newest is shown beside its controls. */
export async function fastStopOne(one) {
  const isNewest = one.stopping();
  one.problem.value = null;
  try {
    await fastStop(one.name);
  } catch (problem) {
    if (isNewest()) one.problem.value = problem;
  }
}
