// Servo sessions: which client steers the fingers, how often, and how old the target is that the gripper has.
//
// Events report the beginning and the end of a session. Its figures are read only for the shown gripper, and only while a
// session is open: the topic `telemetry` would be a second message for each measured value of all grippers.

import { computed, effect } from '../lib.js';
import { read } from './reads.js';
import { isLive, shownGripper } from './state.js';

/** Interval of reads. Faster figures cannot be read. */
const READ_EVERY_MS = 500;

/** The targets a second since the last look; null if this is the first one at a session. */
function rateOf(report, before, at) {
  if (before?.lookedAt === undefined) return null;
  return ((report.accepted - before.accepted) * 1000) / (at - before.lookedAt);
}

/** Reads whether a client steers the fingers. Without a session since the gateway's start, the answer is `not_found`. */
export async function learnServo(gripper) {
  const take = gripper.asking('servo');
  try {
    const report = await read('servo', gripper);
    const lookedAt = performance.now();
    take(report.open ? { ...report, lookedAt, hz: rateOf(report, gripper.servo.peek(), lookedAt) } : null);
  } catch ({ code }) {
    if (code === 'not_found') take(null);
  }
}

/** Applies an event about a session. */
export function takeServo({ event, at, subject, adapter }, gripper) {
  if (event === 'servo_started')
    gripper.asking('servo')({ by: subject, adapter, accepted: 0, lookedAt: performance.now() });
  if (event !== 'servo_ended') return;
  gripper.servoEndedAt = Date.parse(at);
  gripper.asking('servo')(null);
}

const isWatched = computed(() => isLive.value && Boolean(shownGripper.value?.servo.value));

effect(() => {
  if (!isWatched.value) return;
  const gripper = shownGripper.peek();
  const timer = setInterval(() => learnServo(gripper), READ_EVERY_MS);
  return () => clearInterval(timer);
});
