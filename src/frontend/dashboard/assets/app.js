// The page: a bar that is always there, and one of five views.

import { html, render, signal, useEffect } from './lib.js';
import { LANGUAGES, language, t } from './model/i18n.js';
import { myName, theme } from './model/prefs.js';
import { gripper, view, VIEWS } from './model/store.js';
import { Alarms, Announcer } from './ui/alarms.js';
import { Bar, Picker } from './ui/bar.js';
import { Jaws } from './ui/jaws.js';
import { Motion } from './ui/motion.js';
import { Choice } from './ui/parts.js';
import { go, start } from './ui/route.js';

function Views() {
  return html`<nav class="views" aria-label=${t('nav.label')}>
    ${VIEWS.map((name) => html`<button type="button" key=${name} data-view=${name}
        aria-current=${view.value === name ? 'page' : 'false'} onClick=${() => go(name)}>${t(`nav.${name}`)}</button>`)}
  </nav>`;
}

/** What is looked at second is fetched once what is looked at first is there. */
const later = signal({});

async function fetchLater() {
  const [{ Charts }, { Control }, { Flags }] = await Promise.all([import('./views/charts.js'),
      import('./views/control.js'), import('./views/flags.js')]);
  later.value = { Charts, Control, Flags };
  const [{ History }, { Log }, { Device }, { All }] = await Promise.all([import('./views/history.js'),
      import('./views/log.js'), import('./views/device.js'), import('./views/overview.js')]);
  ofView.value = { operate: Operate, history: History, log: Log, device: Device, all: All };
}

function Operate({ one }) {
  const { Charts, Control, Flags } = later.value;
  return html`<div class="operate">
    <${Jaws} one=${one} /><${Motion} one=${one} />
    ${Charts && html`<${Charts} one=${one} />`}
    <div class="column-more"><${Alarms} />${Control && html`<${Control} one=${one} /><${Flags} one=${one} />`}</div>
  </div>`;
}

const ofView = signal({ operate: Operate });

function Main() {
  const one = gripper.value;
  useEffect(() => {
    // For whoever measures: what is there to see is on the screen with the frame after this.
    if (!one) return;
    requestAnimationFrame(() => {
      performance.mark('useful');
      fetchLater();
    });
  }, [one !== null]);
  if (!one) return html`<main class="waiting"><p>${t('stale.connecting')}</p></main>`;
  const View = ofView.value[view.value];
  if (!View) return html`<main class="waiting"></main>`;
  return html`<main key=${view.value === 'all' ? 'all' : one.name}><${View} one=${one} /></main>`;
}

function Footer() {
  return html`<footer class="foot">
    <p class="safety">${t('foot.safety')}</p>
    <div class="prefs">
      <label for="my-name">${t('foot.name')}</label>
      <input id="my-name" type="text" maxlength="32" value=${myName.value}
          onChange=${(event) => { myName.value = event.currentTarget.value.trim() || myName.peek(); }} />
      <${Choice} label=${t('foot.language')} name="language" value=${language.value}
          onChange=${(key) => { language.value = key; }} options=${LANGUAGES.map((key) => [key, key.toUpperCase()])} />
      <${Choice} label=${t('foot.theme')} name="theme" value=${theme.value}
          onChange=${(key) => { theme.value = key; }} options=${['auto', 'light', 'dark'].map((key) => [key,
              t(`theme.${key}`)])} />
      <a href="/docs">${t('foot.docs')}</a>
    </div>
  </footer>`;
}

function App() {
  return html`<a class="skip" href="#main"
      onClick=${(event) => { event.preventDefault(); document.querySelector('main button, main input')?.focus(); }}>${t('nav.skip')}
        </a>
    <${Bar} />
    <div class="navigation"><${Picker} /><${Views} /></div>
    <div id="main"><${Main} /></div>
    <${Footer} /><${Announcer} />`;
}

start();
document.getElementById('app').replaceChildren();
render(html`<${App} />`, document.getElementById('app'));
