// Reads about a gripper, a few at a time.

import { paced } from '../core/paced.js';
import { rpc } from './wire.js';

/** Limit of the page's own reads in flight: the gateway allows 32 requests on a connection. */
const MAX_READS = 8;

const inTurn = paced(MAX_READS);
/** Reads about a gripper, a few at a time. */
export const read = (method, gripper, params = {}) =>
  inTurn(() => rpc.call(method, { gripper: gripper.name, ...params }));

/** Fetches what a state does not contain: limits, and the terms of the lease. */
export function learn(gripper) {
  return Promise.allSettled(['info', 'lease'].map((field) => read(field, gripper).then(gripper.asking(field))));
}

export const ALL_SETTINGS = ['acceleration', 'force-limit', 'soft-limits', 'device-tag'];

/** Fetches the device's settings; events report later changes. Returns the problem, or null. */
export async function learnSettings(gripper, names = ['soft-limits', 'force-limit']) {
  const reads = names.map((name) => read(`settings.${name}`, gripper).then(gripper.askingSettings()));
  return (await Promise.allSettled(reads)).find(({ status }) => status === 'rejected')?.reason ?? null;
}
