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

export class Jog {
  /** The newest press. */
  #press = null;
  #settled = Promise.resolve();

  /** `limits` are the widths that may be reached. */
  begin(one, direction, speed, limits) {
    if (this.#press?.isHeld || !one.isMine.peek()) return;
    const press = { isHeld: true, command: null, epoch: one.held.peek().epoch };
    press.over = new Promise((resolve) => { press.letGo = resolve; });
    this.#press = press;
    // One after the other: the end of a press must not end what the next one renews.
    this.#settled = this.#settled.then(() => this.#hold(one, press, direction, speed, limits)).catch(() => {});
  }

  end(one) {
    if (!this.#press?.isHeld) return;
    this.#press.isHeld = false;
    this.#press.letGo();
    stop(one, this.#press);
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
      if (lease && press.isHeld) {
        const command = await move(one, 'move', { width_mm: direction < 0 ? limits.min : limits.max, speed_mm_s: speed });
        press.command = command?.id ?? null;
      }
      await press.over;
      await this.#stop(one, press);
    } finally {
      clearInterval(renewing);
    }
    // Control lives with the connection again.
    if (isOurs(one, press)) await changeTerms(one);
  }

  /** Once, and again until it has stopped. */
  async #stop(one, press) {
    for (let tries = 0; tries < MAX_STOPS && isOurs(one, press); tries += 1) {
      stop(one, press);
      await new Promise((resolve) => { setTimeout(resolve, STOPPED_EVERY_MS); });
      const isOver = one.newest?.moving === false && (press.command === null || one.newest?.command !== press.command);
      if (isOver || !rpc.isOpen) return;
    }
  }
}

/** Whether control is still what it was when the button was pressed: what moves under another's is the other's. */
function isOurs(one, { epoch }) {
  return one.held.peek()?.epoch === epoch && one.newest?.lease_epoch === epoch;
}

/** Ends the motion of a press, by its name as soon as that is known: so no other's is ended, whatever happens meanwhile. */
function stop(one, press) {
  const ended = press.command === null ? (isOurs(one, press) ? rpc.call('stop', { gripper: one.name }) : null)
    : rpc.call('cancel', { gripper: one.name, command: press.command });
  ended?.catch(() => {});
}
