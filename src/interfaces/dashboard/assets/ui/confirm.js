// A button for a step that cannot be undone. It asks for confirmation beside its own place, where a double click cannot
// give it.

import { html, useEffect, useSignal } from '../lib.js';
import { t } from '../model/i18n.js';

/**
 * `label` and `sureLabel` are texts, and `of` is a suffix that makes the accessible names unique. The question ends when
 * `topic` changes. `isAtEnd` is for a button at the right end of its row: then the confirmation is at the left.
 */
export function ConfirmButton({ id, label, sureLabel, of = '', topic, disabled = false, isAtEnd = false, act }) {
  const isSure = useSignal(false);
  useEffect(() => {
    isSure.value = false;
  }, [topic]);
  if (!isSure.value)
    return html`<button type="button" id=${id} aria-label=${`${label}${of}`} disabled=${disabled} onClick=${() => {
      isSure.value = true;
    }}>${label}</button>`;
  const cancel = html`<button type="button" key="cancel" id=${`${id}-cancel`} aria-label=${`${t('cancel')}: ${label}${of}`}
      onClick=${() => {
        isSure.value = false;
      }}>${t('cancel')}</button>`;
  const sure = html`<button type="button" key="sure" id=${`${id}-sure`} class="primary" disabled=${disabled}
      aria-label=${`${sureLabel}${of}`} onClick=${() => {
        isSure.value = false;
        act();
      }}>${sureLabel}</button>`;
  return isAtEnd ? [sure, cancel] : [cancel, sure];
}
