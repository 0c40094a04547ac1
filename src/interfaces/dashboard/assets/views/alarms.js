// List of the alarms.

import { html } from '../lib.js';
import { sorted } from '../core/alarms.js';
import { moment, t } from '../model/i18n.js';
import { acknowledgeAlarm, alarms, selected } from '../model/store.js';
import { Panel, Shape } from '../ui/parts.js';
import { go } from '../ui/route.js';

const FINGER_FAULT = 'flag/FINGER_FAULT';

/** Text of an alarm with its gripper. */
export const alarmName = (alarm) => (alarm.gripper ? `${alarm.gripper}: ${alarmText(alarm)}` : alarmText(alarm));

export function alarmText({ what }) {
  const [kind, detail] = what.split('/');
  return kind === 'link' || kind === 'flag' ? t(`alarm.${kind}.${detail}`) : t(`alarm.${kind}`);
}

/** Opens a view of the alarm's gripper, and scrolls to a panel. */
function show(alarm, wantedView, panel) {
  selected.value = alarm.gripper;
  go(wantedView);
  requestAnimationFrame(() => document.getElementById(panel)?.scrollIntoView({ block: 'center' }));
}

function Row({ alarm }) {
  const isLatch = alarm.what.startsWith('fast_stop/') && !alarm.clearedAt;
  const words = alarm.clearedAt ? 'alarm.cleared' : alarm.acknowledgedAt ? 'alarm.acknowledged' : 'alarm.active';
  return html`<li class=${`alarm tone-${alarm.clearedAt || alarm.acknowledgedAt ? 'over' : alarm.priority}`}>
    <${Shape} name=${alarm.priority} />
    <div class="alarm-text"><strong>${alarmName(alarm)}</strong>
      <span class="muted small">${t(words)} · ${moment(alarm.since)}${alarm.clearedAt ? ` – ${moment(alarm.clearedAt)}` : ''}${alarm.cause ? ` · ${alarm.cause}` : ''}
        </span></div>
    ${
      alarm.what === FINGER_FAULT &&
      html`<button type="button" aria-label=${`${t('finger.title')}: ${alarm.gripper}`} onClick=${() =>
        show(alarm, 'device', 'fingers-title')}>${t('finger.title')}</button>`
    }
    ${
      isLatch
        ? html`<button type="button" aria-label=${`${t('alarm.show')}: ${alarmName(alarm)}`}
        onClick=${() => show(alarm, 'operate', 'motion-title')}>${t('alarm.show')}
          </button>`
        : !alarm.acknowledgedAt &&
          html`<button type="button" aria-label=${t('alarm.acknowledge_one', {
            alarm: alarmName(alarm),
          })} onClick=${() => acknowledgeAlarm(alarm.id)}>${t('alarm.acknowledge')}</button>`
    }
  </li>`;
}

export function Alarms() {
  const list = sorted(alarms.value);
  return html`<${Panel} title=${t('alarm.title')} id="alarms" class="alarms-panel">
    ${
      list.length === 0
        ? html`<p class="muted nothing"><${Shape} name="check" /> ${t('alarm.none')}</p>`
        : html`<ul class="alarm-list">${list.map((alarm) => html`<${Row} key=${alarm.id} alarm=${alarm} />`)}</ul>`
    }
    <p class="hint">${t('alarm.hint')}</p>
  </${Panel}>`;
}

/** Makes screen readers announce a new alarm at once, in any view. */
export function Announcer() {
  const newest = alarms.value.find((alarm) => !alarm.clearedAt && !alarm.acknowledgedAt);
  return html`<div class="visually-hidden" aria-live="assertive" role="alert">${newest ? alarmName(newest) : ''}</div>`;
}
