// Feeds the page from its WebSocket: subscriptions, messages, the state of the connection, and the clock.

import { batch, computed, effect, signal } from '../lib.js';
import { gatewayNow, noteTime } from '../core/clock.js';
import { connectionAfter } from '../core/connection.js';
import { noteGateway, takeAlarms } from './alarms.js';
import { keepAsking } from './asking.js';
import { catchUp, takeEvent, takeGap, takeGrip } from './events.js';
import { noteJournalChange } from './journal.js';
import { recognizeAgain } from './me.js';
import { ALL_SETTINGS, learn, learnSettings } from './reads.js';
import { learnServo } from './servo.js';
import { showNow, showSoon } from './screen.js';
import { connection, ensure, find, shownGripper, grippers, heardAt, keepOnly, now, view } from './state.js';
import { lookForNewer } from './version.js';
import { handlers, rpc } from './wire.js';

/** Maximum rate of states per gripper: with one gripper in view, with all in view, and on a hidden page. */
const HZ = { shown: 20, all: 5, hidden: 1 };
/** Maximum rate of all grippers together: each message costs processor time of a panel. */
const MAX_HZ_TOGETHER = 40;

/** Interval of polls, which keep a silence shorter than `STALE_AFTER_MS`. */
const ASKED_EVERY_MS = 500;
const LOOKED_EVERY_MS = 200;

/**
 * Consecutive looks that must find silence before the page acts on it: about 2 s on a visible page, which may be busy.
 */
const ACTS_AFTER_LOOKS = 4;

/** Silence after which the connection is replaced. */
const RENEWED_AFTER_MS = 4000;

const isHidden = signal(document.hidden);
/** Time at which the connection was opened. */
let openedAt = -Infinity;
/** Time of its newest message. */
let lastHeard = -Infinity;
/** Number of consecutive looks that have found no live connection. */
let silentLooks = 0;

function takeState(state, at = performance.now()) {
  const gripper = ensure(state.gripper);
  gripper.take(state, at);
  if (state.link === 'connected' && state.measured_at) noteTime(state.measured_at);
  keepAsking(gripper);
  showSoon();
}

Object.assign(handlers, {
  onOpen: () => {
    openedAt = performance.now();
    subscribe();
    lookForNewer();
  },
  onEnd: () => {
    lastHeard = -Infinity;
    // A lease ends with its connection.
    grippers.peek().forEach((gripper) => {
      gripper.loseControl('disconnected');
      gripper.held.value = null;
    });
    // The gateway closes the connection of a person who has to sign in.
    if (rpc.isWanted) recognizeAgain();
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
    if (method === 'grip') takeGrip(params, find(params.gripper));
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
  return Math.max(HZ.all, Math.min(view.value === 'all' ? HZ.all : HZ.shown, share));
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
    showNow();
    noteJournalChange();
    look();
    // Starts from these states; events report what comes after them.
    grippers.peek().forEach((gripper) => catchUp(gripper).catch(() => {}));
    const takes = new Map(grippers.peek().map((gripper) => [gripper.name, gripper.asking('info')]));
    const answer = await rpc.call('grippers');
    answer.grippers.forEach((info) => (takes.get(info.gripper) ?? ensure(info.gripper).asking('info'))(info));
    const shown = shownGripper.peek();
    const inOrder = [...grippers.peek()].sort((a, b) => (b === shown) - (a === shown));
    const settings = (gripper) => learnSettings(gripper, gripper === shown ? shownSettings : undefined);
    await Promise.all(inOrder.flatMap((gripper) => [learn(gripper), learnServo(gripper), settings(gripper)]));
  } catch {
    // The connection has ended, and will be replaced.
  }
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
      if (next !== 'live') grippers.peek().forEach((gripper) => gripper.loseSight());
    }
    noteGateway(next === 'lost' || (next === 'silent' && isSure));
    if (next === 'live') heardAt.value = gatewayNow() - silence;
    const second = Math.floor(gatewayNow() / 1000) * 1000;
    if (second !== now.peek()) now.value = second;
  });
  if (isSure && rpc.isOpen && at - Math.max(lastHeard, openedAt) > RENEWED_AFTER_MS) rpc.renew();
}

setInterval(look, LOOKED_EVERY_MS);
setInterval(() => {
  const asked = shownGripper.peek();
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
