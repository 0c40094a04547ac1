// Choice of several alarms to acknowledge. The list stays as it was when it was opened, so that nothing unseen is
// acknowledged.

import { html, signal, useEffect, useSignal } from '../lib.js';
import { t } from '../model/i18n.js';
import { alarmName, causeText } from '../ui/alarm.js';
import { SEEN_AFTER_MS, shortId } from '../core/ids.js';

/** Alarms to choose from; null while the choice is closed. */
export const choosing = signal(null);

const idOf = (alarm) => shortId(alarm.fast_stop_id ?? alarm.id);

export function Chooser({ list, onAcknowledge }) {
  const chosen = useSignal(new Set(list));
  const isSeen = useSignal(false);
  useEffect(() => {
    const timer = setTimeout(() => {
      isSeen.value = true;
    }, SEEN_AFTER_MS);
    return () => clearTimeout(timer);
  }, []);
  const toggle = (alarm) => {
    const next = new Set(chosen.peek());
    if (!next.delete(alarm)) next.add(alarm);
    chosen.value = next;
  };
  const close = () => {
    choosing.value = null;
    document.getElementById('alarms')?.focus();
  };
  const hasStop = [...chosen.value].some(({ alarm }) => alarm === 'fast_stop');
  return html`<fieldset class="chooser"><legend>${t('alarm.choose')}</legend>
    <ul>${list.map(
      (alarm) => html`<li key=${alarm.id}><label><input type="checkbox" checked=${chosen.value.has(alarm)}
        onChange=${() => toggle(alarm)} /> <span>${alarmName(alarm)} <code>…${idOf(alarm)}</code>
          <span class="muted small">${causeText(alarm) ?? ''}</span></span></label></li>`,
    )}</ul>
    ${hasStop && html`<p class="hint">${t('alarm.clears')}</p>`}
    <div class="buttons"><button type="button" id="acknowledge-alarms" class="primary"
        disabled=${!isSeen.value || chosen.value.size === 0} onClick=${() => {
          onAcknowledge([...chosen.peek()]);
          close();
        }}>${t('alarm.acknowledge_count', { count: chosen.value.size })}</button>
      <button type="button" onClick=${close}>${t('cancel')}</button></div>
  </fieldset>`;
}
