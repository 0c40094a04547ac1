// Frames on a gripper's wire, over a separate connection: hundreds of frames a second must not delay states.
// The connection is opened with the log, and stays open while another view is shown.

import { computed, effect, signal } from '../lib.js';
import { view } from './state.js';
import { Rpc } from '../net/rpc.js';

const MAX_FRAMES = 1000;
/** Interval of screen updates: faster ones cannot be read. */
const SHOWN_EVERY_MS = 200;
/** Ids of automatic updates. */
const UPDATES = [0x40, 0x41, 0x43, 0x44, 0x45];
/** Position of the status in a reply's hex, and the hex of `E_CMD_PENDING`. */
const [STATUS_AT, PENDING] = [12, '1a00'];

/**
 * Frames, and rows about frames that are left out: `updates`, `paused`, `gap`, `lost` and `away`, each with a `count`.
 */
export const frames = signal([]);
export const hasUpdates = signal(false);
export const isPaused = signal(false);

/** Frames of the editor's request: `{id, sent, received}`. */
export const exchange = signal(null);

let rows = [];
let isWaiting = false;
let nextRow = 0;
/** The followed gripper and its connection. */
let followed = null;

/** While another view hides the log, folded updates would only cost processor time. */
const wanted = computed(() => (view.value === 'log' || hasUpdates.value ? 'frames' : 'exchanges'));

const subscribeTo = ({ name, rpc }) =>
  rpc.call('subscribe', { grippers: [name], topics: [wanted.peek()] }).catch(() => {});

effect(() => {
  const isAway = wanted.value === 'exchanges';
  if (!followed) return;
  if (isAway) leaveOut('away', new Date().toISOString());
  if (followed.rpc.isOpen) subscribeTo(followed);
});

function push(row) {
  rows.push(row);
  if (rows.length > MAX_FRAMES) rows.shift();
  if (isWaiting) return;
  isWaiting = true;
  setTimeout(show, SHOWN_EVERY_MS);
}

/** Counts frames that are left out. Consecutive ones share a row. */
function leaveOut(direction, at, count = 1) {
  const last = rows.at(-1);
  if (last?.direction !== direction) {
    nextRow += 1;
    push({ seq: `${direction}-${nextRow}`, direction, at, count });
    return;
  }
  // A new object, because rows are compared by identity.
  rows.pop();
  push({ ...last, count: last.count + count });
}

function watchExchange(frame) {
  const watched = exchange.peek();
  if (frame.damage || frame.id !== watched?.id) return;
  if (frame.direction === 'sent') {
    if (!watched.sent) exchange.value = { ...watched, sent: frame };
    return;
  }
  const isOver = watched.received && !watched.received.hex.startsWith(PENDING, STATUS_AT);
  if (watched.sent && !isOver) exchange.value = { ...watched, received: frame };
}

function take(frame) {
  watchExchange(frame);
  if (isPaused.peek()) leaveOut('paused', frame.at);
  else if (!hasUpdates.peek() && !frame.damage && frame.direction === 'received' && UPDATES.includes(frame.id))
    leaveOut('updates', frame.at);
  else push(frame);
}

function show() {
  isWaiting = false;
  frames.value = [...rows];
}

export function clear() {
  rows = [];
  show();
}

/** Follows a gripper's frames from now on, instead of another gripper's. */
export function follow(name) {
  if (followed?.name === name) return;
  followed?.rpc.close();
  clear();
  exchange.value = null;
  let isFirst = true;
  const rpc = new Rpc({
    onOpen: () => {
      if (!isFirst) leaveOut('lost', new Date().toISOString());
      isFirst = false;
      subscribeTo({ name, rpc });
    },
    onNotification: (method, params) => {
      if (method === 'frame' || method === 'damage') take(params);
      if (method === 'gap') leaveOut('gap', new Date().toISOString(), params.missed);
    },
  });
  followed = { name, rpc };
}
