// Presets: named values for the fields, stored in this browser.

import { html, useSignal } from '../lib.js';
import { t } from '../model/i18n.js';
import { changePresets, presets } from '../model/prefs.js';

const MAX_PRESETS = 12;

export function Presets({ one, fields }) {
  const name = useSignal('');
  const mine = presets.value[one.name] ?? [];
  const use = (preset) => {
    fields.width.value = preset.width;
    fields.speed.value = preset.speed;
    fields.force.value = preset.force;
    if (preset.open !== undefined) fields.open.value = preset.open;
  };
  const save = (event) => {
    event.preventDefault();
    const given = name.value.trim() || `${fields.width.value} mm`;
    const [width, open, speed, force] = ['width', 'open', 'speed', 'force'].map((field) => fields[field].value);
    const preset = { name: given, width, open, speed, force };
    changePresets(one.name, (list) => [...list.filter((other) => other.name !== given), preset].slice(-MAX_PRESETS));
    name.value = '';
  };
  return html`<div class="presets">
    <h3>${t('preset.title')}</h3>
    <div class="preset-list">
      ${mine.length === 0 && html`<span class="muted small">${t('preset.none')}</span>`}
      ${mine.map(
        (preset) => html`<span class="preset" key=${preset.name}>
        <button type="button" class="chip" title=${`${preset.width} mm, ${preset.speed} mm/s, ${preset.force} N`}
            onClick=${() => use(preset)}>${preset.name}</button>
        <button type="button" class="chip chip-end" aria-label=${t('preset.remove', { name: preset.name })}
            onClick=${() => changePresets(one.name, (list) => list.filter((other) => other.name !== preset.name))}>×</button>
      </span>`,
      )}
    </div>
    <form class="preset-new" onSubmit=${save}>
      <label class="visually-hidden" for="preset-name">${t('preset.name')}</label>
      <input id="preset-name" type="text" maxlength="24" placeholder=${t('preset.name')} value=${name.value}
          onInput=${(event) => {
            name.value = event.currentTarget.value;
          }} />
      <button type="submit">${t('preset.save')}</button>
    </form>
  </div>`;
}
