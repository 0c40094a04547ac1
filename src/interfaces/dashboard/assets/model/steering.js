// Steering: while a slider is held, its value goes to the gateway many times a second, in a servo session. The session ends
// when the slider is released. A page that hangs or is lost sends no targets, and the gateway then stops the fingers.

import { effect } from '../lib.js';
import { ask, sentStop } from './commands.js';
import { rpc } from './wire.js';

const SENT_EVERY_MS = 20;

/** Silence after which the gateway stops the fingers. */
const SILENT_AFTER_MS = 200;

export class Steering {
  /** The newest press, until it is released. */
  #press = null;
  #settled = Promise.resolve();

  /** Begins a press at a width. `terms` are those of its session. */
  begin(gripper, width, terms) {
    if (this.#press !== null || !gripper.isMine.peek()) return;
    const press = { width };
    /** Ends as `released`, as `stopped` by this page's FAST STOP, or as `ended` by anything else. */
    press.over = new Promise((resolve) => {
      press.end = resolve;
    });
    this.#press = press;
    // One after the other: a session begins after that of the last press has ended.
    this.#settled = this.#settled.then(() => hold(gripper, press, terms)).catch(() => {});
  }

  aim(width) {
    if (this.#press !== null) this.#press.width = width;
  }

  end() {
    this.#press?.end('released');
    this.#press = null;
  }
}

async function hold(gripper, press, terms) {
  const before = sentStop.peek();
  // No target follows a FAST STOP of this page, also before the gateway has it.
  const endWatch = effect(() => {
    const stop = sentStop.value;
    if (stop !== before && (stop.gripper ?? gripper.name) === gripper.name) press.end('stopped');
  });
  const session = await ask(gripper, 'servo.start', { timeout_ms: SILENT_AFTER_MS, ...terms });
  if (session !== null) {
    press.startedAt = Date.parse(session.started_at);
    const timer = setInterval(() => send(gripper, press), SENT_EVERY_MS);
    const how = await press.over;
    clearInterval(timer);
    if (how === 'ended' && gripper.isMine.peek()) gripper.problem.value = { code: 'no_servo' };
    if (how === 'released') await rpc.call('servo.stop', leaseOf(gripper)).catch(() => {});
  }
  endWatch();
}

const leaseOf = (gripper) => ({ gripper: gripper.name, lease: gripper.held.peek()?.token });

function send(gripper, press) {
  // The event about the end of the session before can arrive after the beginning of this one.
  if (!gripper.isMine.peek() || gripper.servoEndedAt > press.startedAt) press.end('ended');
  else rpc.notify('servo.target', { ...leaseOf(gripper), width_mm: press.width });
}
