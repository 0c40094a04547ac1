// Texts of an alarm.

import { nameIn, person } from '../core/people.js';
import { t } from '../model/i18n.js';

/** Text of an alarm with its gripper or gateway. */
export function alarmName(alarm) {
  const of = alarm.gripper ?? alarm.gateway;
  return of ? `${of}: ${t(`alarm.${alarm.alarm}`)}` : t(`alarm.${alarm.alarm}`);
}

/** Cause of an alarm; for a FAST STOP also who requested it. */
export function causeText(alarm) {
  if (alarm.alarm !== 'fast_stop') return alarm.cause;
  const by = alarm.fast_stop_by === 'device' ? '' : `, ${person(alarm.fast_stop_by, nameIn(alarm.fast_stop_reason))}`;
  return `${t(`cause.${alarm.cause}`)}${by}`;
}
