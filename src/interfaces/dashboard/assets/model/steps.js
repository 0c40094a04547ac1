// Motions that a person at this page can start now, and the next step.

import { mustRelease, nextStep } from '../core/next.js';
import { holderName } from './name.js';
import { isLive } from './state.js';

/** Key of the reason why a motion is not possible now, or null. */
export function whyNot(gripper, needsReference = true) {
  if (!isLive.value || !gripper.isThere.value) return 'why.link';
  if (gripper.latchId.value) return 'why.fast_stop';
  if (gripper.flags.value === null) return 'why.flags';
  if (!gripper.isMine.value) return 'why.control';
  if (gripper.servo.value) return 'why.steered';
  if (gripper.runs.value || gripper.isMotionRequested.value) return 'why.running';
  if (needsReference && !gripper.isReferenced.value) return 'why.not_referenced';
  return null;
}

/** Like `whyNot`, for a grip. */
export function whyNoGrip(gripper) {
  const reason = whyNot(gripper);
  if (reason !== null) return reason;
  return mustRelease(gripper.gripperState.value, gripper.info.value?.firmware) ? 'why.release_first' : null;
}

/** The next step, as in `nextStep`. */
export const stepOf = (gripper) =>
  nextStep({
    isLive: isLive.value,
    link: gripper.link.value,
    isLatched: gripper.latchId.value !== null,
    hasFlags: gripper.flags.value !== null,
    isMine: gripper.isMine.value,
    isMyReservation: gripper.reservedFor.value !== null && gripper.reservedFor.value === holderName.value,
    reserved: gripper.reservedFor.value,
    holder: gripper.holder.value,
    hasAsked: gripper.isControlRequested.value,
    isSteered: gripper.servo.value !== null,
    runs: Boolean(gripper.runs.value || gripper.isMotionRequested.value),
    isReferenced: gripper.isReferenced.value,
    state: gripper.gripperState.value,
  });
