// Texts of an alarm.

import { nameIn, person } from '../core/people.js';
import { namesIn, withNames } from '../core/values.js';
import { t } from '../model/i18n.js';
import { valueName, valueNames } from '../ui/unknown.js';

const VALUE_UNKNOWN = 'value_unknown';

/** Names of the unknown values of an alarm, as a text; empty for other alarms. */
function valuesText({ alarm, cause }) {
  const names = alarm === VALUE_UNKNOWN ? namesIn(cause ?? '') : [];
  return names.length > 0 ? ` (${valueNames(names)})` : '';
}

/** Kind of an alarm, with the unknown values. */
export const kindText = (alarm) => `${t(`alarm.${alarm.alarm}`)}${valuesText(alarm)}`;

/** Text of an alarm with its gripper or gateway. */
export function alarmName(alarm) {
  const of = alarm.gripper ?? alarm.gateway;
  return of ? `${of}: ${kindText(alarm)}` : kindText(alarm);
}

/** Cause of an alarm; for a FAST STOP also who requested it. */
export function causeText(alarm) {
  if (alarm.alarm === VALUE_UNKNOWN) return withNames(alarm.cause ?? '', valueName);
  if (alarm.alarm !== 'fast_stop') return alarm.cause;
  const by = alarm.fast_stop_by === 'device' ? '' : `, ${person(alarm.fast_stop_by, nameIn(alarm.fast_stop_reason))}`;
  return `${t(`cause.${alarm.cause}`)}${by}`;
}
