// What the page knows, fed by one WebSocket. Messages are taken as they come; the screen is told less than ten times a second.

import { batch, computed, effect, signal } from '../lib.js';
import { acknowledged, GATEWAY_GONE, updated, wrongWith } from '../core/alarms.js';
import { Rpc } from '../net/rpc.js';
import { catchUp, take as takeEvent } from './events.js';
import { lookForNewer } from './version.js';
import { Gripper } from './gripper.js';

/** So often states of each gripper come at most: where one is in view, of all at a glance, and where nobody looks. */
const HZ = { one: 20, all: 5, hidden: 1 };
/** And of all grippers together: each message costs a panel's processor. */
const MAX_HZ_TOGETHER = 40;

/** So often the screen changes: faster is not read, and costs a panel's processor. */
const SHOWN_EVERY_MS = 120;

/** Without anything from the gateway for that long, what is shown may be old: it is said within 2 s. It is asked in time. */
const STALE_AFTER_MS = 1200;
const ASKED_EVERY_MS = 500;
const LOOKED_EVERY_MS = 200;

/** A connection on which nothing comes for that long is given up. */
const RENEWED_AFTER_MS = 4000;

export const VIEWS = ['operate', 'history', 'log', 'device', 'all'];

export const grippers = signal([]);
export const selected = signal(null);
export const view = signal('operate');
export const alarms = signal([]);
/** `connecting` at first, then `live`, `silent` or `lost`. */
export const connection = signal('connecting');
/** When the newest message came: the time of day. */
export const heardAt = signal(null);
/** Ticks by the second, for ages. */
export const now = signal(Date.now());
/** The newest event's number, so that what shows the journal looks again. */
export const eventSeq = signal(0);
/** Names that were heard of lately, by which door, and when: looked at by the second, since busy cells would change it all the time. */
export const others = new Map();

const isHidden = signal(document.hidden);
const byName = new Map();
let lastHeard = -Infinity;
let isDirty = false;
let shownAt = 0;
const drawings = new Set();

export const isLive = computed(() => connection.value === 'live');
/** Which never becomes another one by itself: null where it isn't served here any more. */
export const gripper = computed(() => grippers.value.find(({ name }) => name === selected.value) ?? null);

export const find = (name) => byName.get(name);

function ensure(name) {
  if (!byName.has(name)) {
    byName.set(name, new Gripper(name));
    grippers.value = [...byName.values()].sort((a, b) => a.name.localeCompare(b.name));
  }
  return byName.get(name);
}

/** What this gateway serves is told by each connection anew. */
function keepOnly(names) {
  for (const name of byName.keys()) if (!names.includes(name)) byName.delete(name);
  grippers.value = grippers.peek().filter(({ name }) => byName.has(name));
  selected.value ??= grippers.peek()[0]?.name ?? null;
}

function noteAlarms() {
  const wrong = grippers.value.flatMap((one) => (one.newest ? wrongWith(one.newest) : []));
  if (connection.value === 'lost' || connection.value === 'silent') wrong.push(GATEWAY_GONE);
  alarms.value = updated(alarms.value, wrong, Date.now());
}

function show() {
  isDirty = false;
  shownAt = performance.now();
  batch(() => {
    grippers.value.forEach((one) => one.show());
    noteAlarms();
  });
  drawings.forEach((draw) => draw());
}

/** Draws with what is shown, in the same frame of the screen, until the answer is called. */
export function drawWith(draw) {
  drawings.add(draw);
  return () => drawings.delete(draw);
}

function takeState(state, at = performance.now()) {
  ensure(state.gripper).take(state, at);
  if (isDirty) return;
  isDirty = true;
  // A page that isn't seen gets no frames.
  const next = () => (document.hidden ? show() : requestAnimationFrame(show));
  setTimeout(next, Math.max(0, shownAt + SHOWN_EVERY_MS - performance.now()));
}

export const rpc = new Rpc({
  onOpen: () => {
    subscribe();
    lookForNewer();
  },
  onEnd: () => {
    // What was held lives with the connection.
    byName.forEach((one) => {
      one.held.value = null;
    });
    look();
  },
  onHeard: (at) => {
    lastHeard = Math.max(lastHeard, at);
  },
  onTold: (method, params, at) => {
    if (method === 'state') takeState(params, at);
    if (method === 'event') takeEvent(params, find(params.gripper), at);
    if (method === 'command' && find(params.gripper)) find(params.gripper).command.value = params;
    // Events were missed: how things are now is asked anew.
    if (method === 'gap') subscribe();
  },
});

const hz = computed(() => {
  if (isHidden.value) return HZ.hidden;
  const share = Math.floor(MAX_HZ_TOGETHER / Math.max(1, grippers.value.length));
  return Math.max(HZ.all, Math.min(view.value === 'all' ? HZ.all : HZ.one, share));
});

/** So often states are told by this connection. */
const askedHz = signal(null);

const askFor = (max_hz) => rpc.call('subscribe', { topics: ['state', 'events'], max_hz });

async function subscribe() {
  try {
    const begun = rpc.begun();
    askedHz.value = begun?.params.max_hz ?? hz.peek();
    const { states, event_seq: seq } = await (begun?.answer ?? askFor(askedHz.peek()));
    // How often depends on how many there are.
    batch(() => {
      states.forEach((state) => takeState(state, begun?.at));
      keepOnly(states.map((state) => state.gripper));
    });
    show();
    eventSeq.value = seq;
    look();
    // By the states as they were told here: what comes after them is told by events.
    grippers.peek().forEach((one) => catchUp(one).catch(() => {}));
    const told = await rpc.call('grippers');
    told.grippers.forEach((info) => {
      ensure(info.gripper).info.value = info;
    });
    await Promise.all(grippers.peek().flatMap((one) => [learn(one), learnSettings(one)]));
  } catch {
    // The connection has ended, and will be made again.
  }
}

/** What no state tells: limits, and the terms of the lease. */
export async function learn(one) {
  const [info, lease] = await Promise.allSettled([
    rpc.call('info', { gripper: one.name }),
    rpc.call('lease', { gripper: one.name }),
  ]);
  batch(() => {
    if (info.value) one.info.value = info.value;
    if (lease.value) one.lease.value = lease.value;
  });
}

/** What the device is set to; what changes later is told by events. Answers what was wrong with it, or null. */
export async function learnSettings(one, names = ['soft-limits', 'force-limit']) {
  const told = await Promise.allSettled(names.map((name) => rpc.call(`settings.${name}`, { gripper: one.name })));
  told.forEach(({ value }) => value && one.takeSettings(value));
  return told.find(({ status }) => status === 'rejected')?.reason ?? null;
}

export function acknowledgeAlarm(id) {
  alarms.value = acknowledged(alarms.value, id, Date.now());
}

/** Whether what is shown is of now. */
function look() {
  const silence = performance.now() - lastHeard;
  const next = !rpc.isOpen
    ? connection.peek() === 'connecting'
      ? 'connecting'
      : 'lost'
    : silence > STALE_AFTER_MS
      ? 'silent'
      : 'live';
  batch(() => {
    if (next !== connection.peek()) {
      connection.value = next;
      if (next !== 'live') byName.forEach((one) => one.samples.gap());
      noteAlarms();
    }
    if (next === 'live') heardAt.value = Date.now() - silence;
    const second = Math.floor(Date.now() / 1000) * 1000;
    if (second !== now.peek()) now.value = second;
  });
  if (silence > RENEWED_AFTER_MS && rpc.isOpen) rpc.renew();
}

setInterval(look, LOOKED_EVERY_MS);
setInterval(() => {
  const asked = gripper.peek();
  // Whatever is answered: the gateway is there.
  if (rpc.isOpen && asked) rpc.call('state', { gripper: asked.name }, RENEWED_AFTER_MS).then(takeState, () => {});
}, ASKED_EVERY_MS);

effect(() => {
  if (askedHz.value === null || askedHz.value === hz.value || !rpc.isOpen) return;
  askedHz.value = hz.value;
  askFor(hz.value).then(
    ({ states, event_seq: seq }) => {
      states.forEach((state) => takeState(state));
      eventSeq.value = Math.max(eventSeq.peek(), seq);
    },
    () => {},
  );
});

document.addEventListener('visibilitychange', () => {
  isHidden.value = document.hidden;
  look();
  rpc.hurry();
});
addEventListener('online', () => rpc.hurry());
