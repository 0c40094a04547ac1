// The reason that no WebSocket opens although the gateway answers: a browser does not report it.

import { effect, signal } from '../lib.js';
import { options } from '../net/rest.js';
import { connection } from './state.js';
import { rpc } from './wire.js';

/** Attempts in a row that must fail before the page looks for a reason: a gateway that restarts needs some. */
const LEAST_FAILURES = 3;

/** `origin` if the gateway takes this page for one of another origin, `socket` if no WebSocket reaches the gateway. */
export const obstacle = signal(null);

rpc.onFailed = async (failures) => {
  if (failures < LEAST_FAILURES) return;
  const { code } = await options('ws').catch((problem) => problem);
  if (rpc.isOpen) return;
  // The path has no OPTIONS, so this refusal comes from the gateway itself.
  obstacle.value = { foreign_origin: 'origin', method_not_allowed: 'socket' }[code] ?? null;
};

effect(() => {
  if (connection.value === 'live') obstacle.value = null;
});
