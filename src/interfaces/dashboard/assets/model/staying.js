// Control over a reload, and its end when the page is left.
//
// A lease that was taken on a connection ends with it. Before a reload, the page therefore takes it once more for a few
// seconds by a request, and after the reload takes it back with the same token. The request must reach the gateway before
// the connection ends. While the fingers move, the page does not take it once more: then a page that goes away is a lost
// client, as the terms of the lease say.

import { effect } from '../lib.js';
import { sendLast } from '../net/rest.js';
import { changeTerms, resumeControl, terms } from './commands.js';
import { mustSignIn } from './me.js';
import { STORAGE_PREFIX } from './prefs.js';
import { find, grippers, isLive } from './state.js';
import { rpc } from './wire.js';

const KEY = `${STORAGE_PREFIX}control`;

/** Time to live of the lease while the page is loaded again. */
const KEPT_MS = 8000;

/** Interval at which the page keeps control again, while it waits for the gateway to answer the reload. */
const KEPT_AGAIN_MS = 2000;

/** Time after which a page that was not left after all has control as before. */
const STAYS_AFTER_MS = 20_000;

/** Longest time for which a page that is left waits for its last requests. */
const SENT_WITHIN_MS = 300;

function takeStored() {
  try {
    const stored = JSON.parse(sessionStorage.getItem(KEY) ?? '[]');
    sessionStorage.removeItem(KEY);
    return stored.filter(({ at }) => Math.abs(Date.now() - at) < KEPT_MS);
  } catch {
    return [];
  }
}

/** Leases from before the reload, each with its gripper's name, token and time. */
let stored = takeStored();

effect(() => {
  if (!isLive.value || stored.length === 0) return;
  const there = stored.filter(({ name }) => find(name) !== undefined);
  stored = stored.filter((lease) => !there.includes(lease));
  there.forEach(({ name, token }) => resumeControl(find(name), token));
});

/** Whether the page keeps control over a reload. A motion that no state reports yet counts as moving, and steering too. */
function isKept(gripper) {
  const { moving, command } = gripper.newest;
  const isStill = moving === false && !command && !gripper.isMotionRequested.peek() && gripper.servo.peek() === null;
  return gripper.isMine.peek() && isStill;
}

/** Grippers of which the page keeps control, because it is being left. */
let kept = [];

/** Whether the gateway has answered the last requests. */
let isSent = true;

/** Timer that keeps control again. */
let again = null;

/** The last requests, settled. */
let sending = Promise.resolve();

/** Gives the leases back to the connection of a page that was not left after all. */
function stay() {
  if (kept.length === 0) return;
  clearTimeout(again);
  takeStored();
  const back = kept;
  kept = [];
  const giveBack = () => back.forEach((gripper) => changeTerms(gripper));
  giveBack();
  // A last request can arrive after the terms above, and would keep the lease for longer than the connection.
  if (!isSent) sending.then(giveBack);
}

/** Keeps control while the page is being left. It stays if it is still there at `until`. */
function keep(until) {
  clearTimeout(again);
  if (performance.now() > until) {
    stay();
    return;
  }
  const now = grippers.peek().filter(isKept);
  // A gripper that is not kept any more still has to get its terms back.
  kept = [...new Set([...kept, ...now])];
  if (now.length === 0) {
    stay();
    return;
  }
  isSent = false;
  const requests = now.map((gripper) =>
    sendLast(`grippers/${gripper.name}/lease`, { ...terms(), lease: gripper.held.peek().token, ttl_ms: KEPT_MS }),
  );
  const sent = Promise.allSettled([sending, ...requests]).then(() => {
    if (sending === sent) isSent = true;
  });
  sending = sent;
  try {
    const leases = now.map((gripper) => ({ name: gripper.name, token: gripper.held.peek().token, at: Date.now() }));
    sessionStorage.setItem(KEY, JSON.stringify(leases));
  } catch {
    // Without storage, the lease ends by itself.
  }
  again = setTimeout(keep, KEPT_AGAIN_MS, until);
}

addEventListener('beforeunload', () => keep(performance.now() + STAYS_AFTER_MS));

// A page that moves the fingers was not left, and must not be kept from being a lost client.
effect(() => {
  if (grippers.value.some((gripper) => gripper.isMotionRequested.value)) stay();
});

/**
 * Gives the last requests time to arrive, unless they have been answered. A page that is left can wait in no other way, and
 * no answer arrives meanwhile.
 */
function waitForLastRequests() {
  const end = performance.now() + SENT_WITHIN_MS;
  while (!isSent && performance.now() < end);
}

/** Closes the connection of a page that is no longer shown, until it comes back. */
const leave = () => rpc.close();
const comeBack = () => mustSignIn.peek() || rpc.open();

addEventListener('pagehide', () => {
  waitForLastRequests();
  leave();
});
addEventListener('pageshow', comeBack);
document.addEventListener('freeze', leave);
document.addEventListener('resume', comeBack);
