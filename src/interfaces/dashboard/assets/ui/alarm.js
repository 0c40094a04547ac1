// Texts of an alarm.

import { nameIn, person } from '../core/people.js';
import { namesIn, withNames } from '../core/values.js';
import { breakable, t } from '../model/i18n.js';
import { selected } from '../model/state.js';
import { go } from './route.js';
import { valueName, valueNames } from './unknown.js';

const VALUE_UNKNOWN = 'value_unknown';

/** Names of the unknown values of an alarm, as a text; empty for other alarms. */
function valuesText({ alarm, cause }) {
  const names = alarm === VALUE_UNKNOWN ? namesIn(cause ?? '') : [];
  return names.length > 0 ? ` (${valueNames(names)})` : '';
}

/** Kind of an alarm, with the unknown values. */
export const kindText = (alarm) => `${t(`alarm.${alarm.alarm}`)}${valuesText(alarm)}`;

/** Text of an alarm with its gripper, gateway, token, certificate or webhook. */
export function alarmName(alarm) {
  const of = alarm.gripper ?? alarm.gateway ?? alarm.name;
  return of ? `${breakable(of)}: ${kindText(alarm)}` : kindText(alarm);
}

/** Cause of an alarm; for a FAST STOP also who requested it. */
export function causeText(alarm) {
  if (alarm.alarm === VALUE_UNKNOWN) return withNames(alarm.cause ?? '', valueName);
  if (alarm.alarm !== 'fast_stop') return alarm.cause;
  const by = alarm.fast_stop_by === 'device' ? '' : `, ${person(alarm.fast_stop_by, nameIn(alarm.fast_stop_reason))}`;
  return `${t(`cause.${alarm.cause}`)}${by}`;
}

/** Opens a view of the alarm's gripper, and scrolls to a panel. */
export function showPanel(alarm, wantedView, panel) {
  if (alarm.gripper !== null) selected.value = alarm.gripper;
  go(wantedView);
  requestAnimationFrame(() => document.getElementById(panel)?.scrollIntoView({ block: 'center' }));
}

/** Shows where an alarm can be acknowledged. */
export const showAlarm = (alarm) => showPanel(alarm, 'operate', alarm.alarm === 'fast_stop' ? 'latch-title' : 'alarms');
