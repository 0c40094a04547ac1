// Number fields, with units and limits.

import { html } from '../lib.js';
import { mistake, number, readings } from '../core/limits.js';
import { plain, t } from '../model/i18n.js';
import { Shape } from './parts.js';

export const limitsText = ({ min, max, whose }, unit) =>
  whose === null
    ? t('limit.unknown')
    : `${plain(min)} – ${plain(max)} ${unit}${whose === 'device' ? '' : ` (${t(`limit.${whose}`)})`}`;

function mistakeText(typed, wrong, limits) {
  const both = readings(typed);
  if (both !== null) return t('limit.ambiguous', { typed: typed.trim(), one: plain(both[0]), other: plain(both[1]) });
  return t(`limit.${wrong}`, { min: plain(limits.min), max: plain(limits.max) });
}

/** `value` is a signal with the typed text; `whenEmpty` is the hint of an empty field. */
export function NumberField({ id, label, unit, value, limits, isOptional = false, whenEmpty = null }) {
  const typed = value.value;
  const isEmpty = isOptional && typed.trim() === '';
  const wrong = isEmpty ? null : mistake(number(typed), limits);
  return html`<div class=${`field ${wrong ? 'wrong' : ''}`}>
    <label for=${id}>${label}</label>
    <div class="input"><input id=${id} type="text" inputmode="decimal" autocomplete="off" value=${typed}
      aria-describedby=${`${id}-hint`} aria-invalid=${wrong ? 'true' : 'false'}
      onInput=${(event) => {
        value.value = event.currentTarget.value;
      }} /><span class="unit">${unit}</span></div>
    <p class="hint" id=${`${id}-hint`}>${
      wrong
        ? html`<${Shape} name="high" /> ${mistakeText(typed, wrong, limits)}`
        : (isEmpty && whenEmpty) || limitsText(limits, unit)
    }</p>
  </div>`;
}
