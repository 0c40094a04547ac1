// Taking control by force, which always asks for confirmation.

import { html, useEffect, useSignal } from '../lib.js';
import { t } from '../model/i18n.js';
import { takeControl } from '../model/commands.js';

/** `place` is a prefix that makes the ids unique; `of` is a suffix that makes the accessible names unique. */
export function Force({ one, place = '', of = '' }) {
  const isSure = useSignal(false);
  const name = (key) => `${t(key)}${of}`;
  // The confirmation is for this gripper and this holder.
  useEffect(() => {
    isSure.value = false;
  }, [one, one.state.value?.lease_epoch]);
  if (!isSure.value)
    return html`<button type="button" id=${`${place}force-control`} aria-label=${name('control.force')}
        onClick=${() => {
          isSure.value = true;
        }}>${t('control.force')}</button>`;
  return html`<button type="button" id=${`${place}force-sure`} class="primary" aria-label=${name('control.force_sure')}
      onClick=${() => {
        isSure.value = false;
        takeControl(one, { force: true });
      }}>${t('control.force_sure')}</button>
    <button type="button" aria-label=${name('cancel')} onClick=${() => {
      isSure.value = false;
    }}>${t('cancel')}</button>`;
}
