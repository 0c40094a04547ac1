// Updates of the screen: messages apply at once, but are shown less than ten times a second.

import { batch } from '../lib.js';
import { grippers } from './state.js';

/** Interval of screen updates: faster ones cannot be read, and cost processor time. */
const SHOWN_EVERY_MS = 120;

let isDirty = false;
let shownAt = 0;
const drawings = new Set();

/** Shows the newest states at once. */
export function showNow() {
  isDirty = false;
  shownAt = performance.now();
  batch(() => grippers.value.forEach((gripper) => gripper.show()));
  drawings.forEach((draw) => draw());
}

/** Calls `draw` after each update, in the same frame of the screen, until the returned function is called. */
export function drawWith(draw) {
  drawings.add(draw);
  return () => drawings.delete(draw);
}

/** Shows the newest states with the next update. */
export function showSoon() {
  if (isDirty) return;
  isDirty = true;
  // A hidden page gets no frames.
  const next = () => (document.hidden ? showNow() : requestAnimationFrame(showNow));
  setTimeout(next, Math.max(0, shownAt + SHOWN_EVERY_MS - performance.now()));
}
