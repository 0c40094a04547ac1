// The form to sign in with a token.

import { effect, html, signal } from '../lib.js';
import { releaseControl } from '../model/commands.js';
import { ofProblem, t } from '../model/i18n.js';
import { enterPin, forgetPin, me, mustSignIn, signIn, signOut } from '../model/me.js';
import { grippers } from '../model/state.js';
import { rpc } from '../model/wire.js';
import { noConnection } from '../net/rpc.js';
import { addNotices } from './strip.js';

// The gateway refuses the connections of a person who has to sign in, and records each refusal.
effect(() => {
  if (mustSignIn.value) rpc.close();
  else rpc.open();
});

const NEXT_RANK = 90;

addNotices(() =>
  mustSignIn.value ? [{ key: 'sign-in', rank: NEXT_RANK, kind: 'next', shape: 'next', text: t('signin.next') }] : [],
);

/** Problem of the last attempt. */
const refused = signal(null);

export function SignIn() {
  const submit = async (event) => {
    event.preventDefault();
    const field = event.currentTarget.elements.namedItem('token');
    try {
      await signIn(field.value.trim());
    } catch (problem) {
      refused.value = problem ?? noConnection();
      field.select();
    }
  };
  return html`<main class="waiting"><form class="panel sign-in" onSubmit=${submit}>
    <h2>${t('signin.title')}</h2>
    <label for="token">${t('signin.token')}</label>
    <input id="token" name="token" type="password" autocomplete="current-password" required autofocus />
    ${refused.value && html`<p role="alert">${ofProblem(refused.value)}</p>`}
    <button type="submit" class="primary">${t('signin.do')}</button>
    <p class="hint">${t('signin.hint')}</p>
  </form></main>`;
}

/** Longest wait for the gateway to take back control. */
const RELEASED_WITHIN_MS = 1000;

/** Whether the field for a PIN is open, and the problem of the last PIN. */
const isEntering = signal(false);
const refusedPin = signal(null);

/** A field for the PIN of a person at a shared panel. */
function PinField() {
  const submit = async (event) => {
    event.preventDefault();
    const field = event.currentTarget.elements.namedItem('pin');
    try {
      await enterPin(field.value);
      isEntering.value = false;
      refusedPin.value = null;
    } catch (problem) {
      refusedPin.value = problem ?? noConnection();
      field.select();
    }
  };
  return html`<form class="pin" onSubmit=${submit}>
    <label for="pin">${t('pin.label')}</label>
    <input id="pin" name="pin" type="password" inputmode="numeric" pattern="[0-9]{6}" maxlength="6" size="6"
      autocomplete="off" required autofocus />
    <button type="submit" class="primary">${t('pin.do')}</button>
    ${refusedPin.value && html`<span role="alert">${refusedPin.value.detail ?? ofProblem(refusedPin.value)}</span>`}
  </form>`;
}

/** Gives up control of all grippers, and then the rights of the PIN, even if the gateway does not respond. */
async function lock() {
  const mine = grippers.peek().filter((gripper) => gripper.isMine.peek());
  // One after the other: the gateway limits the requests in progress.
  let isOver = false;
  const released = mine.reduce(
    (before, gripper) => before.then(() => isOver || releaseControl(gripper)),
    Promise.resolve(),
  );
  await Promise.race([released, new Promise((resolve) => setTimeout(resolve, RELEASED_WITHIN_MS))]);
  // What the next person controls is not released.
  isOver = true;
  await forgetPin();
}

/** The name of the person, with buttons to sign out, to enter a PIN, and to forget it. */
export function SignedIn() {
  const { proof, name, role } = me.value ?? {};
  if (proof !== 'session' && proof !== 'pin') return null;
  const who = html`<span class="signed-in">${t('signin.as', { name, role: t(`role.${role}`) })}</span>`;
  if (proof === 'pin') return html`${who}<button type="button" id="lock" onClick=${lock}>${t('pin.forget')}</button>`;
  const open = () => {
    isEntering.value = !isEntering.value;
  };
  const canDoMore = role === 'observer' || role === 'stop';
  return html`${who}
    ${canDoMore && html`<button type="button" id="enter-pin" aria-expanded=${isEntering.value} onClick=${open}>${t('pin.enter')}</button>`}
    ${canDoMore && isEntering.value && html`<${PinField} />`}
    <button type="button" onClick=${signOut}>${t('signin.out')}</button>`;
}
