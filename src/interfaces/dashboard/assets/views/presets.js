// Presets: named values for the fields, stored in this browser.

import { html, useSignal } from '../lib.js';
import { t } from '../model/i18n.js';
import { changePresets, presets } from '../model/prefs.js';

const MAX_PRESETS = 12;
const FIELDS = ['width', 'open', 'speed', 'force'];

export function Presets({ one, fields }) {
  const name = useSignal('');
  const mine = presets.value[one.name] ?? [];
  // `{text, act}` to undo the newest step.
  const undo = useSignal(null);
  const change = (text, edit) => {
    changePresets(one.name, edit);
    undo.value = { text, act: () => changePresets(one.name, () => mine) };
  };
  const use = (preset) => {
    const before = FIELDS.map((field) => fields[field].value);
    undo.value = {
      text: t('preset.used', { name: preset.name }),
      act: () =>
        FIELDS.forEach((field, index) => {
          fields[field].value = before[index];
        }),
    };
    fields.width.value = preset.width;
    fields.speed.value = preset.speed;
    fields.force.value = preset.force;
    if (preset.open !== undefined) fields.open.value = preset.open;
  };
  const save = (event) => {
    event.preventDefault();
    const given = name.value.trim() || `${fields.width.value} mm`;
    const [width, open, speed, force] = FIELDS.map((field) => fields[field].value);
    const preset = { name: given, width, open, speed, force };
    change(t('preset.saved', { name: given }), (list) =>
      [...list.filter((other) => other.name !== given), preset].slice(-MAX_PRESETS),
    );
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
            onClick=${() =>
              change(t('preset.removed', { name: preset.name }), (list) =>
                list.filter((other) => other.name !== preset.name),
              )}>×</button>
      </span>`,
      )}
    </div>
    <p class="preset-undo small" role="status">${
      undo.value &&
      html`${undo.value.text} <button type="button" class="quiet" id="preset-undo" onClick=${() => {
        undo.value.act();
        undo.value = null;
      }}>${t('undo')}</button>`
    }</p>
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
