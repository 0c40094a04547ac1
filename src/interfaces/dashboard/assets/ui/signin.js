// The form to sign in with a token.

import { html, signal } from '../lib.js';
import { ofProblem, t } from '../model/i18n.js';
import { me, signIn, signOut } from '../model/me.js';
import { noConnection } from '../net/rpc.js';

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

/** The name of the person, with a button to sign out. */
export function SignedIn() {
  if (me.value?.proof !== 'session') return null;
  const { name, role } = me.value;
  return html`<span class="signed-in">${t('signin.as', { name, role: t(`role.${role}`) })}</span>
    <button type="button" onClick=${signOut}>${t('signin.out')}</button>`;
}
