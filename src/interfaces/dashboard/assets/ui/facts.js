// A list of facts: names and values.

import { html } from '../lib.js';
import { t } from '../model/i18n.js';

/** `facts` are pairs of a text's key and a value. Pairs without a value are left out. */
export function Facts({ facts }) {
  return html`<dl class="facts">${facts
    .filter(([, value]) => value !== null && value !== undefined && value !== '')
    .map(
      ([key, value]) => html`<div key=${key}>
        <dt>${t(key)}</dt><dd>${value}</dd></div>`,
    )}</dl>`;
}
