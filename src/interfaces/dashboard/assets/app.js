// The page: a permanent bar, and one of five views.

import { html, render, signal, useEffect } from './lib.js';
import { LANGUAGES, language, t } from './model/i18n.js';
import { isStranger, mayOperate, recognize } from './model/me.js';
import { MAX_NAME_BYTES, myName, rename } from './model/name.js';
import { theme } from './model/prefs.js';
import { gripper, isLive, selected, view, VIEWS } from './model/store.js';
import { Bar, Picker } from './ui/bar.js';
import { Jaws } from './ui/jaws.js';
import { keepFocus } from './ui/focus.js';
import { Choice, within } from './ui/parts.js';
import { go, start } from './ui/route.js';
import { SignedIn, SignIn } from './ui/signin.js';

function Views() {
  return html`<nav class="views" aria-label=${t('nav.label')}>
    ${VIEWS.map(
      (name) => html`<button type="button" key=${name} data-view=${name}
        aria-current=${view.value === name ? 'page' : 'false'} onClick=${() => go(name)}>${t(`nav.${name}`)}</button>`,
    )}
  </nav>`;
}

/** Components that are loaded after the first screen (state and STOP), by name. */
const later = signal({});

/** Whether one of these modules could not be loaded. */
const isMissing = signal(false);

function Missing() {
  if (!isMissing.value) return null;
  return html`<div class="newer missing"><p role="alert">${t('part.missing')}</p><button type="button"
      onClick=${() => location.reload()}>${t('reload')}</button></div>`;
}

async function fetchAll(...parts) {
  const fetched = await Promise.allSettled(parts);
  later.value = Object.assign({}, later.peek(), ...fetched.map(({ value }) => value ?? {}));
  if (fetched.some(({ status }) => status === 'rejected')) isMissing.value = true;
}

const FETCH_VIEW = {
  history: () => import('./views/history.js'),
  log: () => import('./views/log.js'),
  device: () => import('./views/device.js'),
  all: () => import('./views/overview.js'),
};

async function fetchLater() {
  const { [view.peek()]: shown, ...others } = FETCH_VIEW;
  // Each part is shown as soon as it is loaded.
  await Promise.all(
    [import('./views/motion.js'), import('./views/alarms.js'), import('./views/notices.js'), shown?.()].map((part) =>
      fetchAll(part),
    ),
  );
  await fetchAll(import('./views/charts.js'), import('./views/control.js'), import('./views/flags.js'));
  await fetchAll(...Object.values(others).map((fetchView) => fetchView()));
}

function Operate({ one }) {
  const { Alarms, Charts, Control, Flags, Motion } = later.value;
  return html`<div class="operate">
    <${Jaws} one=${one} />${Motion && mayOperate(one.name) && html`<${Motion} one=${one} />`}
    ${Charts && html`<${Charts} one=${one} />`}
    <div class="column-more">${Alarms && html`<${Alarms} />`}${
      Control &&
      mayOperate(one.name) &&
      html`<${Control}
        one=${one} />`
    }${Flags && html`<${Flags} one=${one} />`}</div>
  </div>`;
}

function viewOf(name) {
  const { All, Device, History, Log } = later.value;
  return { operate: Operate, history: History, log: Log, device: Device, all: All }[name];
}

function Main() {
  const one = gripper.value;
  const isKnown = one !== null || isLive.value;
  useEffect(() => {
    if (!isKnown) return;
    // The next frame shows the first screen. A hidden page gets no frames.
    if (document.hidden) fetchLater();
    else requestAnimationFrame(fetchLater);
  }, [isKnown]);
  if (isStranger.value) return html`<${SignIn} />`;
  if (!one)
    return html`<main class="waiting"><p>${
      isLive.value && selected.value
        ? t('stale.not_served', {
            gripper: selected.value,
          })
        : t('stale.connecting')
    }</p></main>`;
  const View = viewOf(view.value);
  if (!View) return html`<main class="waiting" />`;
  return html`<main key=${view.value === 'all' ? 'all' : one.name}><${View} one=${one} /></main>`;
}

function Footer() {
  return html`<footer class="foot">
    <p class="safety">${t('foot.safety')}</p>
    <div class="prefs">
      <${SignedIn} />
      <label for="my-name">${t('foot.name')}</label>
      <input id="my-name" type="text" value=${myName.value} onInput=${within(MAX_NAME_BYTES, () => {})}
          onChange=${(event) => {
            rename(event.currentTarget.value);
            event.currentTarget.value = myName.peek();
          }} />
      <${Choice} label=${t('foot.language')} name="language" value=${language.value}
          onChange=${(key) => {
            language.value = key;
          }} options=${LANGUAGES.map((key) => [key, key.toUpperCase()])} />
      <${Choice} label=${t('foot.theme')} name="theme" value=${theme.value}
          onChange=${(key) => {
            theme.value = key;
          }} options=${['auto', 'light', 'dark'].map((key) => [key, t(`theme.${key}`)])} />
      <a href="/docs/guide" target="_blank" rel="noopener">${t('foot.guides')}</a>
      <a href="/docs" target="_blank" rel="noopener">${t('foot.docs')}</a>
    </div>
  </footer>`;
}

function App() {
  const { Announcer, Notices } = later.value;
  return html`<a class="skip" href="#main"
      onClick=${(event) => {
        event.preventDefault();
        document.querySelector('main button, main input')?.focus();
      }}>${t('nav.skip')}
        </a>
    <${Bar} notices=${Notices} />
    <div class="navigation"><${Picker} /><${Views} /></div>
    <div id="main"><${Missing} /><${Main} /></div>
    <${Footer} />${Announcer && html`<${Announcer} />`}`;
}

const app = document.getElementById('app');
start();
app.replaceChildren();
render(html`<${App} />`, app);
keepFocus(app);
recognize();
