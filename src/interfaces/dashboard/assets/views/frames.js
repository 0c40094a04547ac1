// Frames on a gripper's wire, over a connection of their own: hundreds a second must not delay the grippers' states.
// The connection is open only while the log is shown.

import { signal } from '../lib.js';
import { Rpc } from '../net/rpc.js';

const MAX_FRAMES = 400;
/** Interval of screen updates: faster ones cannot be read. */
const SHOWN_EVERY_MS = 200;
/** Ids of automatic updates. */
const UPDATES = [0x40, 0x41, 0x43, 0x44, 0x45];

export const frames = signal([]);
export const hasUpdates = signal(false);
export const isPaused = signal(false);

let waiting = [];

function take(frame) {
  if (isPaused.peek() || (!hasUpdates.peek() && frame.direction === 'received' && UPDATES.includes(frame.id))) return;
  if (waiting.length === 0) setTimeout(show, SHOWN_EVERY_MS);
  waiting.push(frame);
  if (waiting.length > MAX_FRAMES) waiting.shift();
}

function show() {
  frames.value = [...frames.peek(), ...waiting].slice(-MAX_FRAMES);
  waiting = [];
}

export function clear() {
  frames.value = [];
}

/** Follows a gripper's frames until the returned function is called. */
export function follow(name) {
  clear();
  const rpc = new Rpc({
    onOpen: () => rpc.call('subscribe', { grippers: [name], topics: ['frames'] }).catch(() => {}),
    onNotification: (method, params) => {
      if (method === 'frame' || method === 'damage') take(params);
      if (method === 'gap') take({ seq: `gap-${params.seq}`, direction: 'gap', missed: params.missed });
    },
  });
  return () => rpc.close();
}
