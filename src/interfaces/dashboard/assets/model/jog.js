// Jogging: the fingers move while somebody holds a button, and stop when it is let go, or when the page can't say that
// it is still held. While they do, control lives by a timer of this page instead of the connection's: a page that hangs
// renews nothing, and is lost within a second.

import { changeTerms, move } from './commands.js';
import { rpc } from './store.js';
import { onLossMoving } from './prefs.js';

const LIVES_MS = 1000;
const RENEWED_EVERY_MS = 250;
const STOPPED_EVERY_MS = 150;
/** Then the command's end is somebody else's matter: the page shows what moves. */
const MAX_STOPS = 40;
/** How a command ends whose fingers stand, or have been given to another. */
const ENDED_BY_ITSELF = ['SUCCESS', 'ABORTED'];

export class Jog {
  /** The newest press. */
  #press = null;
  #settled = Promise.resolve();

  /** `limits` are the widths that may be reached. */
  begin(one, direction, speed, limits) {
    if (this.#press?.isHeld || !one.isMine.peek()) return;
    const press = { isHeld: true, isUnanswered: false, command: null, epoch: one.held.peek().epoch };
    press.over = new Promise((resolve) => {
      press.letGo = resolve;
    });
    this.#press = press;
    // One after the other: the end of a press must not end what the next one renews.
    this.#settled = this.#settled.then(() => this.#hold(one, press, direction, speed, limits)).catch(() => {});
  }

  end() {
    if (!this.#press?.isHeld) return;
    this.#press.isHeld = false;
    this.#press.letGo();
  }

  async #hold(one, press, direction, speed, limits) {
    if (!press.isHeld) return;
    // Fingers whose page has gone must not go on, whatever else is allowed to finish.
    const on_loss_moving = onLossMoving.peek() === 'finish' ? 'fast_stop' : onLossMoving.peek();
    const lease = await changeTerms(one, { ttl_ms: LIVES_MS, on_loss_moving });
    const renewing = setInterval(() => {
      const held = one.held.peek();
      if (held) rpc.call('lease.renew', { gripper: one.name, lease: held.token }).catch(() => {});
    }, RENEWED_EVERY_MS);
    try {
      if (lease && press.isHeld)
        begun(one, press, { width_mm: direction < 0 ? limits.min : limits.max, speed_mm_s: speed });
      await press.over;
      await stopped(one, press);
    } finally {
      clearInterval(renewing);
    }
    // Control lives with the connection again.
    if (isOurs(one, press)) await changeTerms(one);
  }
}

/** Asks for the motion of a press, whose name may be told only after the button was let go. */
async function begun(one, press, way) {
  press.isUnanswered = true;
  const command = await move(one, 'move', way);
  press.command = command?.id ?? null;
  press.isUnanswered = false;
}

/** Stops it, again and again until it has stopped. What is not answered yet may still begin. */
async function stopped(one, press) {
  for (let tries = 0; tries < MAX_STOPS; tries += press.isUnanswered ? 0 : 1) {
    stop(one, press);
    await new Promise((resolve) => {
      setTimeout(resolve, STOPPED_EVERY_MS);
    });
    if (!press.isUnanswered && isOver(one, press)) return;
  }
}

/** Whether control is still what it was when the button was pressed: what moves under another's is the other's. */
function isOurs(one, { epoch }) {
  return one.held.peek()?.epoch === epoch && one.newest?.lease_epoch === epoch;
}

function isOver(one, press) {
  const { moving, command } = one.newest;
  if (!isOurs(one, press) && press.command === null) return true;
  if (press.command !== null && command === press.command) return false;
  return moving === false || (command !== null && !isOurs(one, press));
}

/**
 * Ends the motion of this press by its name, which stops nobody else's. Where that has no name, or has ended although the
 * fingers may go on, because its answer was lost, whatever moves is stopped while control is ours.
 */
function stop(one, press) {
  if (press.command === null) {
    stopAll(one, press);
    return;
  }
  rpc
    .call('cancel', { gripper: one.name, command: press.command })
    .then(({ outcome }) => {
      if (outcome && !ENDED_BY_ITSELF.includes(outcome)) stopAll(one, press);
    })
    .catch(() => {});
}

function stopAll(one, press) {
  if (isOurs(one, press)) rpc.call('stop', { gripper: one.name }).catch(() => {});
}
