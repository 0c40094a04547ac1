// The page: a permanent bar, and one of five views.

import { html, render, signal, useEffect } from './lib.js';
import { fetchLater, fetchViews, isMissing, laterParts, otherViews } from './loading.js';
import { LANGUAGES, language, t } from './model/i18n.js';
import { mustSignIn, mayOperate, recognize } from './model/me.js';
import { MAX_NAME_BYTES, myName, rename } from './model/name.js';
import { theme } from './model/prefs.js';
import './model/feed.js';
import './model/staying.js';
import { shownGripper, isLive, selected, view, VIEWS } from './model/state.js';
import { Bar, Picker } from './ui/bar.js';
import { Jaws } from './ui/jaws.js';
import { keepFocus } from './ui/focus.js';
import { Obstacle } from './ui/obstacle.js';
import { Choice, within } from './ui/parts.js';
import { go, start } from './ui/route.js';
import { SignedIn, SignIn } from './ui/signin.js';
import { Strip } from './ui/strip.js';

function Views() {
  if (mustSignIn.value) return null;
  return html`<nav class="views" aria-label=${t('nav.label')}>
    ${VIEWS.map(
      (name) => html`<button type="button" key=${name} data-view=${name}
        aria-current=${view.value === name ? 'page' : 'false'} onClick=${() => go(name)}>${t(`nav.${name}`)}</button>`,
    )}
  </nav>`;
}

function Missing() {
  if (!isMissing.value) return null;
  return html`<div class="missing"><p role="alert">${t('part.missing')}</p><button type="button"
      onClick=${() => location.reload()}>${t('reload')}</button></div>`;
}

function Operate({ gripper }) {
  const { Alarms, Charts, Latch, Motion, Recipes, WhoControls } = laterParts.value;
  const isOperator = Motion && mayOperate(gripper.name);
  const isLatched = gripper.latchId.value !== null;
  return html`<div class=${`operate ${isOperator ? '' : 'watching'} ${isLatched ? 'latched' : ''}`}>
    <${Jaws} gripper=${gripper} />
    ${isOperator && html`<${WhoControls} gripper=${gripper} /><${Motion} gripper=${gripper} />`}
    ${isOperator && isLatched && html`<${Latch} gripper=${gripper} />`}${isOperator && !isLatched && html`<${Recipes} gripper=${gripper} />`}
    ${Charts && html`<${Charts} gripper=${gripper} />`}
    ${Alarms && html`<${Alarms} />`}
  </div>`;
}

function viewOf(name) {
  const { All, Device, History, Log } = otherViews.value;
  return { operate: Operate, history: History, log: Log, device: Device, all: All }[name];
}

/** Names of the components that `?view=` shows alone, in another page. They move nothing. */
const WIDGETS = { jaws: 'Jaws', charts: 'Charts', flags: 'Flags', alarms: 'Alarms', all: 'All' };

const widget = WIDGETS[new URLSearchParams(location.search).get('view')];

function Widget({ gripper }) {
  const Shown = { Jaws, ...laterParts.value, ...otherViews.value }[widget];
  return html`<main class="widget">${Shown && html`<${Shown} gripper=${gripper} />`}</main>`;
}

function Main() {
  const gripper = shownGripper.value;
  const isKnown = gripper !== null || isLive.value;
  useEffect(() => {
    if (!isKnown) return;
    // The next frame shows the first screen. A hidden page gets no frames.
    if (document.hidden) fetchLater();
    else requestAnimationFrame(fetchLater);
  }, [isKnown]);
  const needsOthers = view.value !== 'operate' || widget === 'Flags' || widget === 'All';
  useEffect(() => {
    if (needsOthers && laterParts.value.Motion && !otherViews.peek().All) fetchViews();
  }, [needsOthers, laterParts.value]);
  if (mustSignIn.value) return html`<${SignIn} />`;
  if (!gripper)
    return html`<main class="waiting"><p>${
      isLive.value && selected.value
        ? t('stale.not_served', {
            gripper: selected.value,
          })
        : t('stale.connecting')
    }</p></main>`;
  if (widget) return html`<${Widget} gripper=${gripper} />`;
  const View = viewOf(view.value);
  if (!View) return html`<main class="waiting" />`;
  return html`<main key=${view.value === 'all' ? 'all' : gripper.name}><${View} gripper=${gripper} /></main>`;
}

/** Text in the field of the name before it is entered; null for none. Other changes of the page must not lose it. */
const typedName = signal(null);

function Footer() {
  return html`<footer class="foot">
    <p class="safety">${t('foot.safety')}</p>
    <div class="prefs">
      <${SignedIn} />
      <label for="my-name">${t('foot.name')}</label>
      <input id="my-name" type="text" value=${typedName.value ?? myName.value}
          onInput=${within(MAX_NAME_BYTES, (text) => {
            typedName.value = text;
          })}
          onChange=${(event) => {
            rename(event.currentTarget.value);
            typedName.value = null;
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
      <a href="docs/guide/" target="_blank" rel="noopener">${t('foot.guides')}</a>
      <a href="docs" target="_blank" rel="noopener">${t('foot.docs')}</a>
    </div>
  </footer>`;
}

function App() {
  const { Announcer } = laterParts.value;
  // A key stops from here too.
  if (widget) return html`<${Obstacle} /><${Missing} /><${Main} /><${Strip} />`;
  return html`<a class="skip" href="#main"
      onClick=${(event) => {
        event.preventDefault();
        document.querySelector('main button, main input')?.focus();
      }}>${t('nav.skip')}
        </a>
    <${Bar} /><${Strip} />
    <div class="navigation"><${Picker} /><${Views} /></div>
    <div id="main"><${Obstacle} /><${Missing} /><${Main} /></div>
    <${Footer} />${Announcer && html`<${Announcer} />`}`;
}

const app = document.getElementById('app');
start();
app.replaceChildren();
render(html`<${App} />`, app);
keepFocus(app);
recognize();
