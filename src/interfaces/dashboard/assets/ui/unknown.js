// Texts of unknown values: a dash never stands without its reason.

import { html } from '../lib.js';
import { whyUnknown } from '../core/values.js';
import { t } from '../model/i18n.js';

/** Name of a measured value, which is as in `stale` of the API. */
export const valueName = (name) => t(`value.${name}`);

export const valueNames = (names) => names.map(valueName).join(', ');

/** Why a value of a state is unknown, as a text; null if it is known, or without a state. */
export function unknownText(state, name) {
  const reason = state && whyUnknown(state, name);
  return reason ? t(`unknown.${reason}`, { value: valueName(name) }) : null;
}

/** A dash, or a word, for something unknown. The reason is its tooltip, and is read by screen readers. */
export function Unknown({ word, why }) {
  return html`<span role="img" title=${why} aria-label=${word ? `${word}, ${why}` : why}>${word ?? '–'}</span>`;
}

/** Names the values that the gripper should send and does not. */
export function missingText(gripper) {
  const names = gripper.missing.value;
  return names === null || names === '' ? null : t('unknown.values', { values: valueNames(names.split(' ')) });
}
