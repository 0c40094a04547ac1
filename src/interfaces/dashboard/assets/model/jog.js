// Jogging: the fingers move while a button is held. They stop when it is released, or when the page cannot confirm
// that it is still held. Meanwhile a timer of this page renews the lease, rather than its connection: a page that
// hangs loses control within a second.

import { newJogId } from '../core/jogs.js';
import { changeTerms, move } from './commands.js';
import { rpc } from './wire.js';
import { onLossMoving } from './prefs.js';

const LIVES_MS = 1000;
const RENEWED_EVERY_MS = 250;
const STOPPED_EVERY_MS = 150;
/** Tries after which the page no longer stops the motion, but only shows it. */
const MAX_STOPS = 40;
/** Outcomes after which the fingers stand, or another command moves them. */
const ENDED_BY_ITSELF = ['SUCCESS', 'ABORTED'];

export class Jog {
  /** The newest press. */
  #press = null;
  #settled = Promise.resolve();

  /** `limits` are the lowest and the highest allowed width. */
  begin(gripper, direction, speed, limits) {
    if (this.#press?.isHeld || !gripper.isMine.peek()) return;
    const press = { isHeld: true, isUnanswered: false, command: null, epoch: gripper.held.peek().epoch };
    press.over = new Promise((resolve) => {
      press.letGo = resolve;
    });
    this.#press = press;
    // One after the other: the end of a press must not affect the lease terms of the next one.
    this.#settled = this.#settled.then(() => this.#hold(gripper, press, direction, speed, limits)).catch(() => {});
  }

  end() {
    if (!this.#press?.isHeld) return;
    this.#press.isHeld = false;
    this.#press.letGo();
  }

  async #hold(gripper, press, direction, speed, limits) {
    if (!press.isHeld) return;
    // A jog must stop if its page is lost, even if other motions are allowed to finish.
    const on_loss_moving = onLossMoving.peek() === 'finish' ? 'fast_stop' : onLossMoving.peek();
    const lease = await changeTerms(gripper, { ttl_ms: LIVES_MS, on_loss_moving });
    const renewing = setInterval(() => {
      const held = gripper.held.peek();
      if (held) rpc.call('lease.renew', { gripper: gripper.name, lease: held.token }).catch(() => {});
    }, RENEWED_EVERY_MS);
    try {
      if (lease && press.isHeld)
        begun(gripper, press, {
          width_mm: direction < 0 ? limits.min : limits.max,
          speed_mm_s: speed,
          request_id: newJogId(),
        });
      await press.over;
      await stopped(gripper, press);
    } finally {
      clearInterval(renewing);
    }
    // Control depends on the connection again.
    if (isOurs(gripper, press)) await changeTerms(gripper);
  }
}

/** Starts the motion of a press. Its command id can arrive after the button was released. */
async function begun(gripper, press, way) {
  press.isUnanswered = true;
  const command = await move(gripper, 'move', way);
  press.command = command?.id ?? null;
  press.isUnanswered = false;
}

/** Repeats the stop until the fingers stand. A motion without an answer can still begin. */
async function stopped(gripper, press) {
  for (let tries = 0; tries < MAX_STOPS; tries += press.isUnanswered ? 0 : 1) {
    stop(gripper, press);
    await new Promise((resolve) => {
      setTimeout(resolve, STOPPED_EVERY_MS);
    });
    if (!press.isUnanswered && isOver(gripper, press)) return;
  }
}

/** Whether the lease is still that of the press. Under any other lease, a motion is not that of the press. */
function isOurs(gripper, { epoch }) {
  return gripper.held.peek()?.epoch === epoch && gripper.newest?.lease_epoch === epoch;
}

function isOver(gripper, press) {
  const { moving, command } = gripper.newest;
  if (!isOurs(gripper, press) && press.command === null) return true;
  if (press.command !== null && command === press.command) return false;
  return moving === false || (command !== null && !isOurs(gripper, press));
}

/**
 * Cancels the command of this press, so that no other client's motion stops. If its id is unknown, or if it ended
 * while the fingers can still move (because the answer was lost), any motion is stopped, as long as this page believes
 * that it has control.
 */
function stop(gripper, press) {
  if (press.command === null) {
    stopAll(gripper, press);
    return;
  }
  rpc
    .call('cancel', { gripper: gripper.name, command: press.command })
    .then(({ outcome }) => {
      if (outcome && !ENDED_BY_ITSELF.includes(outcome)) stopAll(gripper, press);
    })
    .catch(() => {});
}

function stopAll(gripper, press) {
  if (isOurs(gripper, press)) rpc.call('stop', { gripper: gripper.name }).catch(() => {});
}
