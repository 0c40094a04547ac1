// Buttons for the usual time ranges of the history.

import { html } from '../lib.js';
import { gatewayNow } from '../core/clock.js';
import { localText, RANGES } from '../core/times.js';
import { t } from '../model/i18n.js';
import { Choice } from '../ui/parts.js';

/** Buttons for the usual ranges. Another touch shows all times again. */
export function Ranges({ from, to, chosen }) {
  const choose = (key) => {
    const isOff = chosen.peek() === key;
    chosen.value = isOff ? null : key;
    from.value = isOff ? '' : localText(RANGES[key](gatewayNow()));
    to.value = '';
  };
  return html`<${Choice} label=${t('history.range')} name="range" value=${chosen.value} onChange=${choose}
      options=${Object.keys(RANGES).map((key) => [key, t(`history.${key}`)])} />`;
}
