// Which client steers the fingers, and how.

import { fixed, t } from '../model/i18n.js';

/** The texts `who` and `how` of an open servo session, or null. Only the holder of control can have one, if there is a holder. */
export function steered(gripper) {
  const servo = gripper.servo.value;
  if (servo === null) return null;
  const name = gripper.holder.value ?? servo.by;
  return {
    who: gripper.isMine.value ? t('servo.mine') : t('servo.by', { name }),
    how: t('servo.how', {
      adapter: t(`adapter.${servo.adapter}`),
      hz: fixed(servo.hz, 0),
      age: fixed(servo.applied_age_ms, 0),
    }),
  };
}
