// The page's state, fed by one WebSocket. Messages apply at once; the screen is updated less than ten times a second.

import { batch, computed, effect, signal } from '../lib.js';
import { connectionAfter } from '../core/connection.js';
import { paced } from '../core/paced.js';
import { Rpc } from '../net/rpc.js';
import { noteGateway, takeAlarms } from './alarms.js';
import { keepAsking } from './asking.js';
import { catchUp, takeEvent, takeGap, takeGrip } from './events.js';
import { noteJournalChange } from './journal.js';
import { recognizeAgain } from './me.js';
import { myName } from './name.js';
import { lookForNewer } from './version.js';
import { Gripper } from './gripper.js';

/** Maximum rate of states per gripper: with one gripper in view, with all in view, and on a hidden page. */
const HZ = { one: 20, all: 5, hidden: 1 };
/** Maximum rate of all grippers together: each message costs processor time of a panel. */
const MAX_HZ_TOGETHER = 40;

/** Interval of screen updates: faster ones cannot be read, and cost processor time. */
const SHOWN_EVERY_MS = 120;

/** Interval of polls, which keep a silence shorter than `STALE_AFTER_MS`. */
const ASKED_EVERY_MS = 500;
const LOOKED_EVERY_MS = 200;

/**
 * Consecutive looks that must find silence before the page acts on it: about 2 s on a visible page, which may be busy.
 */
const ACTS_AFTER_LOOKS = 4;

/** Silence after which the connection is replaced. */
const RENEWED_AFTER_MS = 4000;

/** Limit of the page's own reads in flight: the gateway allows 32 requests on a connection. */
const MAX_READS = 8;

export const VIEWS = ['operate', 'history', 'log', 'device', 'all'];

export const grippers = signal([]);
export const selected = signal(null);
export const view = signal('operate');
/** See `connectionAfter`. */
export const connection = signal('connecting');
/** Wall-clock time of the newest message. */
export const heardAt = signal(null);
/** Wall-clock time in whole seconds, for ages. */
export const now = signal(Date.now());
/** Grippers of all gateways; null until they are known. */
export const fleet = signal(null);
export const hasOthers = computed(() => new Set(fleet.value?.map(({ gateway }) => gateway)).size > 1);
/**
 * Recently active clients: `{subject, label, door, at}` by subject and label. Not a signal, because busy cells would
 * change it all the time.
 */
export const others = new Map();

const isHidden = signal(document.hidden);
const byName = new Map();
/** Time at which the connection was opened. */
let openedAt = -Infinity;
/** Time of its newest message. */
let lastHeard = -Infinity;
/** Number of consecutive looks that have found no live connection. */
let silentLooks = 0;
let isDirty = false;
let shownAt = 0;
const drawings = new Set();

export const isLive = computed(() => connection.value === 'live');
/** Selected gripper, or null if this gateway no longer serves it. Never replaced by another one. */
export const gripper = computed(() => grippers.value.find(({ name }) => name === selected.value) ?? null);

export const find = (name) => byName.get(name);

function ensure(name) {
  if (!byName.has(name)) {
    byName.set(name, new Gripper(name));
    grippers.value = [...byName.values()].sort((a, b) => a.name.localeCompare(b.name, 'en', { numeric: true }));
  }
  return byName.get(name);
}

/** Drops grippers that the gateway no longer serves. */
function keepOnly(names) {
  for (const name of byName.keys()) if (!names.includes(name)) byName.delete(name);
  grippers.value = grippers.peek().filter(({ name }) => byName.has(name));
  selected.value ??= grippers.peek()[0]?.name ?? null;
}

function show() {
  isDirty = false;
  shownAt = performance.now();
  batch(() => grippers.value.forEach((one) => one.show()));
  drawings.forEach((draw) => draw());
}

/** Calls `draw` after each update, in the same frame of the screen, until the returned function is called. */
export function drawWith(draw) {
  drawings.add(draw);
  return () => drawings.delete(draw);
}

function takeState(state, at = performance.now()) {
  const one = ensure(state.gripper);
  one.take(state, at);
  keepAsking(one);
  if (isDirty) return;
  isDirty = true;
  // A hidden page gets no frames.
  const next = () => (document.hidden ? show() : requestAnimationFrame(show));
  setTimeout(next, Math.max(0, shownAt + SHOWN_EVERY_MS - performance.now()));
}

export const rpc = new Rpc({
  label: () => myName.peek(),
  onOpen: () => {
    openedAt = performance.now();
    subscribe();
    lookForNewer();
  },
  onEnd: () => {
    lastHeard = -Infinity;
    // A lease ends with its connection.
    byName.forEach((one) => {
      one.loseControl('disconnected');
      one.held.value = null;
    });
    // The gateway closes the connection of a person who has to sign in.
    recognizeAgain();
    look();
  },
  onHeard: (at) => {
    lastHeard = Math.max(lastHeard, at);
  },
  onNotification: (method, params, at) => {
    if (method === 'state') takeState(params, at);
    if (method === 'alarms') takeAlarms(params);
    if (method === 'event') takeEvent(params, find(params.gripper), at);
    // Its record is complete about a second after a motion's last event.
    if (method === 'grip') takeGrip(find(params.gripper));
    if (method === 'command' && find(params.gripper)) find(params.gripper).command.value = params;
    // Events were missed, or the configuration has changed.
    if (method === 'gap' || params.event === 'reloaded') {
      takeGap();
      subscribe(ALL_SETTINGS);
    }
  },
});

const hz = computed(() => {
  if (isHidden.value) return HZ.hidden;
  const share = Math.floor(MAX_HZ_TOGETHER / Math.max(1, grippers.value.length));
  return Math.max(HZ.all, Math.min(view.value === 'all' ? HZ.all : HZ.one, share));
});

/** Rate requested on this connection. */
const askedHz = signal(null);

const askFor = (max_hz) => rpc.call('subscribe', { topics: ['state', 'events', 'grips', 'alarms'], max_hz });

/** Fetches what may have changed, with `shownSettings` of the shown gripper, and subscribes to further changes. */
async function subscribe(shownSettings) {
  recognizeAgain();
  try {
    const begun = rpc.begun();
    askedHz.value = begun?.params.max_hz ?? hz.peek();
    const { states } = await (begun?.answer ?? askFor(askedHz.peek()));
    // The rate depends on the number of grippers, so it is computed once.
    batch(() => {
      states.forEach((state) => takeState(state, begun?.at));
      keepOnly(states.map((state) => state.gripper));
    });
    show();
    noteJournalChange();
    look();
    // Starts from these states; events report what comes after them.
    grippers.peek().forEach((one) => catchUp(one).catch(() => {}));
    const takes = new Map(grippers.peek().map((one) => [one.name, one.asking('info')]));
    const answer = await rpc.call('grippers');
    answer.grippers.forEach((info) => (takes.get(info.gripper) ?? ensure(info.gripper).asking('info'))(info));
    const shown = gripper.peek();
    const inOrder = [...grippers.peek()].sort((a, b) => (b === shown) - (a === shown));
    const settings = (one) => learnSettings(one, one === shown ? shownSettings : undefined);
    await Promise.all(inOrder.flatMap((one) => [learn(one), settings(one)]));
  } catch {
    // The connection has ended, and will be replaced.
  }
}

const inTurn = paced(MAX_READS);
/** Reads about a gripper, a few at a time. */
export const read = (method, one, params = {}) => inTurn(() => rpc.call(method, { gripper: one.name, ...params }));

/** Fetches what a state does not contain: limits, and the terms of the lease. */
export function learn(one) {
  return Promise.allSettled(['info', 'lease'].map((field) => read(field, one).then(one.asking(field))));
}

export const ALL_SETTINGS = ['acceleration', 'force-limit', 'soft-limits', 'device-tag'];

/** Fetches the device's settings; events report later changes. Returns the problem, or null. */
export async function learnSettings(one, names = ['soft-limits', 'force-limit']) {
  const reads = names.map((name) => read(`settings.${name}`, one).then(one.askingSettings()));
  return (await Promise.allSettled(reads)).find(({ status }) => status === 'rejected')?.reason ?? null;
}

/** Updates the connection state and the clock. */
function look() {
  const at = performance.now();
  const silence = at - lastHeard;
  const next = connectionAfter(connection.peek(), rpc.isOpen, silence);
  silentLooks = next === 'live' ? 0 : silentLooks + 1;
  const isSure = silentLooks >= ACTS_AFTER_LOOKS;
  batch(() => {
    if (next !== connection.peek()) {
      connection.value = next;
      if (next !== 'live') byName.forEach((one) => one.loseSight());
    }
    noteGateway(next === 'lost' || (next === 'silent' && isSure));
    if (next === 'live') heardAt.value = Date.now() - silence;
    const second = Math.floor(Date.now() / 1000) * 1000;
    if (second !== now.peek()) now.value = second;
  });
  if (isSure && rpc.isOpen && at - Math.max(lastHeard, openedAt) > RENEWED_AFTER_MS) rpc.renew();
}

setInterval(look, LOOKED_EVERY_MS);
setInterval(() => {
  const asked = gripper.peek();
  // Any answer shows that the gateway is alive.
  if (rpc.isOpen && asked) rpc.call('state', { gripper: asked.name }, RENEWED_AFTER_MS).then(takeState, () => {});
}, ASKED_EVERY_MS);

effect(() => {
  if (askedHz.value === null || askedHz.value === hz.value || !rpc.isOpen) return;
  askedHz.value = hz.value;
  askFor(hz.value).then(
    ({ states }) => states.forEach((state) => takeState(state)),
    () => {},
  );
});

document.addEventListener('visibilitychange', () => {
  isHidden.value = document.hidden;
  look();
  rpc.hurry();
});
addEventListener('online', () => rpc.hurry());
