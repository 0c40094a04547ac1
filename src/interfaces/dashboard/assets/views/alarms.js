// List of the alarms.

import { html, signal } from '../lib.js';
import { isActive, isOpen, sorted } from '../core/alarms.js';
import { person } from '../core/people.js';
import { acknowledgeAlarms, alarms } from '../model/alarms.js';
import { moment, ofProblem, t } from '../model/i18n.js';
import { mayOperate } from '../model/me.js';
import { isLive } from '../model/state.js';
import { rpc } from '../model/wire.js';
import { Panel, Shape } from '../ui/parts.js';
import { alarmName, causeText, showAlarm, showPanel } from '../ui/alarm.js';
import { Chooser, choosing } from './chooser.js';

/** Texts of refused acknowledgements. */
const refusals = signal([]);

async function acknowledgeShown(chosen) {
  refusals.value = [];
  const refused = await acknowledgeAlarms(rpc, chosen);
  refusals.value = refused.map(({ alarm, problem }) => `${alarmName(alarm)}: ${ofProblem(problem)}`);
}

function stateText(alarm) {
  if (!isActive(alarm)) return t('alarm.cleared');
  if (isOpen(alarm)) return t('alarm.active');
  const { acknowledged_by: by, acknowledged_label: label } = alarm;
  return by ? t('alarm.acknowledged_by', { name: person(by, label) }) : t('alarm.acknowledged');
}

function Row({ alarm }) {
  const until = isActive(alarm) ? '' : ` – ${moment(alarm.ended_at)}`;
  const times = alarm.count > 1 ? ` · ${t('alarm.count', { count: alarm.count })}` : '';
  const cause = causeText(alarm);
  return html`<li class=${`alarm tone-${isActive(alarm) && isOpen(alarm) ? alarm.priority : 'over'}`}>
    <${Shape} name=${alarm.priority} />
    <div class="alarm-text"><strong>${alarmName(alarm)}</strong>
      <span class="muted small">${stateText(alarm)} · ${moment(alarm.began_at)}${until}${times}${cause ? ` · ${cause}` : ''}
        </span></div>
    ${
      alarm.alarm === 'finger_fault' &&
      html`<button type="button" aria-label=${`${t('finger.title')}: ${alarm.gripper}`} onClick=${() =>
        showPanel(alarm, 'device', 'fingers-title')}>${t('finger.title')}</button>`
    }
    ${
      alarm.alarm === 'fast_stop'
        ? html`<button type="button" aria-label=${`${t('alarm.show')}: ${alarmName(alarm)}`}
        onClick=${() => showAlarm(alarm)}>${t('alarm.show')}
          </button>`
        : isOpen(alarm) &&
          mayOperate(alarm.gripper) &&
          html`<button type="button" aria-label=${t('alarm.acknowledge_one', {
            alarm: alarmName(alarm),
          })} onClick=${() => acknowledgeShown([alarm])}>${t('alarm.acknowledge')}</button>`
    }
  </li>`;
}

function NoAlarms() {
  const [shape, text] = isLive.value ? ['check', 'alarm.none'] : ['off', 'bar.alarms_unknown'];
  return html`<p class="muted nothing"><${Shape} name=${shape} /> ${t(text)}</p>`;
}

export function Alarms() {
  const list = sorted(alarms.value);
  const open = list.filter((alarm) => isOpen(alarm) && mayOperate(alarm.gripper));
  const actions =
    open.length > 1 &&
    html`<button type="button" id="choose-alarms" aria-expanded=${choosing.value ? 'true' : 'false'} onClick=${() => {
      choosing.value = choosing.peek() ? null : open;
    }}>${t('alarm.several')}</button>`;
  return html`<${Panel} title=${t('alarm.title')} id="alarms" class="alarms-panel" actions=${actions}>
    ${choosing.value && html`<${Chooser} list=${choosing.value} onAcknowledge=${acknowledgeShown} />`}
    <div role="alert">${refusals.value.map((text) => html`<p key=${text} class="problem">${text}</p>`)}</div>
    ${
      list.length === 0
        ? html`<${NoAlarms} />`
        : html`<ul class="alarm-list">${list.map((alarm) => html`<${Row} key=${alarm.id} alarm=${alarm} />`)}</ul>`
    }
    <p class="hint">${t('alarm.hint')}</p>
  </${Panel}>`;
}

/** Makes screen readers announce a new alarm at once, in any view. */
export function Announcer() {
  const newest = sorted(alarms.value).find((alarm) => isActive(alarm) && isOpen(alarm));
  return html`<div class="visually-hidden" aria-live="assertive" role="alert">${newest ? alarmName(newest) : ''}</div>`;
}
