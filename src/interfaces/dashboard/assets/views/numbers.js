// Numbers per part of the grips that match the filters.

import { html } from '../lib.js';
import { fixed, plain, t } from '../model/i18n.js';

const COLUMNS = ['history.part', 'numbers.count', 'numbers.rate', 'width', 'numbers.trend', 'force', 'numbers.trend'];

const spread = ({ mean, spread: deviation }, unit) =>
  mean === null ? '–' : `${fixed(mean, 2)} ± ${fixed(deviation, 2)} ${unit}`;

const trend = (value, unit) => (value === null ? '–' : `${value > 0 ? '+' : ''}${fixed(value, 2)} ${unit}`);

/** `shown` is a signal with the part whose contact widths are shown, or undefined. */
export function Numbers({ numbers, shown }) {
  const { parts, count, isAll } = numbers;
  return html`<div class="table-place" tabindex="0" role="region" aria-label=${t('numbers.title')}><table class="numbers">
    <thead><tr>${COLUMNS.map(
      (key, index) => html`<th scope="col" key=${index} class=${index > 0 ? 'number' : ''}>${t(key)}</th>`,
    )}</tr></thead>
    <tbody>${parts.map(
      ({ part, count: grips, rate, width, force }) => html`<tr key=${part}><td>${
        part === null
          ? '–'
          : html`<button type="button" class="quiet" aria-pressed=${shown.value === part ? 'true' : 'false'}
          onClick=${() => {
            shown.value = shown.peek() === part ? undefined : part;
          }}>${part}</button>`
      }</td>
        <td class="number">${plain(grips)}</td><td class="number">${fixed(rate * 100, 1)} %</td>
        <td class="number">${spread(width, 'mm')}</td><td class="number">${trend(width.trend, 'mm')}</td>
        <td class="number">${spread(force, 'N')}</td><td class="number">${trend(force.trend, 'N')}</td></tr>`,
    )}</tbody></table></div>
    <p class="hint">${t(isAll ? 'numbers.hint' : 'numbers.bounded', { count })}</p>`;
}
