// The identity and rights of the person at this page.

import { signal } from '../lib.js';
import { ordered } from '../core/newest.js';
import { get, remove, send } from '../net/rest.js';

const ASKED_EVERY_MS = 5000;

/** The identity and rights; null until the gateway says them. */
export const me = signal(null);

/** Whether the gateway asks this person to sign in. */
export const mustSignIn = signal(false);

const asking = ordered();

/** Asks the gateway again. Without an answer, the last one stays. */
export async function recognize() {
  const isNewest = asking();
  try {
    const answer = await get('me');
    if (!isNewest()) return;
    me.value = answer;
    mustSignIn.value = false;
  } catch (problem) {
    if (problem?.code === 'unauthorized' && isNewest()) mustSignIn.value = true;
  }
}

let isFirst = true;

/** Asks again, but not for the first connection: the page itself asks when it begins. */
export function recognizeAgain() {
  // A page that is not signed in does not ask by itself: the gateway records each refusal.
  if (!isFirst && !mustSignIn.peek()) recognize();
  isFirst = false;
}

// Meanwhile, the person can have signed in on another page of this browser.
document.addEventListener('visibilitychange', () => {
  if (!document.hidden && mustSignIn.peek()) recognize();
});

export async function signIn(token) {
  await send('session', { token });
  // All connections begin anew with the session.
  location.reload();
}

export async function signOut() {
  await remove('session');
  location.reload();
}

/** Adds a person's rights to this panel's session. */
export async function enterPin(pin) {
  await send('session/pin', { pin });
  await recognize();
}

export async function forgetPin() {
  await remove('session/pin');
  await recognize();
}

// The rights of a PIN end by themselves, so the page asks whether they have.
setInterval(() => {
  if (me.value?.proof === 'pin') recognize();
}, ASKED_EVERY_MS);

/** Whether the user may operate all grippers, which a change for all of them needs. */
export const mayOperateAll = () => me.value === null || me.value.grippers.every(({ gripper }) => mayOperate(gripper));

/** Whether this person may move a gripper and change its settings. The gateway itself decides. */
export function mayOperate(name) {
  if (me.value === null) return true;
  const role = me.value.grippers.find(({ gripper }) => gripper === name)?.role;
  return role === undefined || role === 'operator' || role === 'supervisor';
}
