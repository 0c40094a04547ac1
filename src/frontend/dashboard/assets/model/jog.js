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
  #press = 0;
  #isHeld = false;
  #renewing = null;

  /** `limits` are the widths that may be reached. */
  async begin(one, direction, speed, limits) {
    if (this.#isHeld || !one.isMine.peek()) return;
    this.#isHeld = true;
    this.#press += 1;
    const press = this.#press;
    const isHeld = () => this.#isHeld && press === this.#press;
    // Fingers whose page has gone must not go on, whatever else is allowed to finish.
    const on_loss_moving = onLossMoving.peek() === 'finish' ? 'fast_stop' : onLossMoving.peek();
    const lease = await changeTerms(one, { ttl_ms: LIVES_MS, on_loss_moving });
    if (lease && isHeld()) {
      this.#renewing = setInterval(() => {
        const held = one.held.peek();
        if (held) rpc.call('lease.renew', { gripper: one.name, lease: held.token }).catch(() => {});
      }, RENEWED_EVERY_MS);
      const command = await move(one, 'move', { width_mm: direction < 0 ? limits.min : limits.max, speed_mm_s: speed });
      // Let go before it was known to run.
      if (command && !isHeld()) await this.#stop(one, command.id);
      this.running = command?.id ?? null;
    }
    if (!isHeld()) await this.#settle(one);
  }

  async end(one) {
    if (!this.#isHeld) return;
    this.#isHeld = false;
    await this.#stop(one, this.running);
    await this.#settle(one);
  }

  /** Once, and again until it has stopped. */
  async #stop(one, command) {
    const press = this.#press;
    for (let tries = 0; tries < MAX_STOPS; tries += 1) {
      rpc.call('stop', { gripper: one.name }).catch(() => {});
      await new Promise((resolve) => { setTimeout(resolve, STOPPED_EVERY_MS); });
      const isOver = one.newest?.moving === false && (command === null || one.newest?.command !== command);
      if (isOver || press !== this.#press || !rpc.isOpen) return;
    }
  }

  /** Control lives with the connection again. */
  async #settle(one) {
    clearInterval(this.#renewing);
    this.#renewing = null;
    this.running = null;
    if (!this.#isHeld) await changeTerms(one);
  }
}
