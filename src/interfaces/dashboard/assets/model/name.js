// Name under which this tab takes control. Each tab is a client of its own: of two tabs with the same name, the older
// one keeps it, and the other gets a number.

import { computed, effect, signal } from '../lib.js';
import { cut } from '../core/bytes.js';
import { kept } from './prefs.js';

/** The gateway's limit of a holder's name. */
export const MAX_NAME_BYTES = 32;

const SESSION = 'wsg.name';

function newName() {
  const random = crypto.getRandomValues(new Uint8Array(2));
  return `browser-${Array.from(random, (byte) => byte.toString(16).padStart(2, '0')).join('')}`;
}

/** Name for tabs that are opened later. */
const usual = kept('name', newName());

function ofThisTab() {
  try {
    return sessionStorage.getItem(SESSION);
  } catch {
    return null;
  }
}

export const myName = signal(ofThisTab() || usual.peek());

effect(() => {
  try {
    sessionStorage.setItem(SESSION, myName.value);
  } catch {
    // The name lasts as long as the page.
  }
});

/** Renames this tab and later ones. Ignores an empty name. */
export function rename(wanted) {
  const name = cut(wanted.trim(), MAX_NAME_BYTES);
  if (name === '') return;
  usual.value = name;
  myName.value = name;
}

/** Whether this browser still has its generated name. */
export const isUnnamed = computed(() => /^browser-[0-9a-f]{4}( \(\d+\))?$/.test(myName.value));

/** Returns the next name in the series `Anna`, `Anna (2)`, `Anna (3)`. */
export function another(name) {
  const [, base, count] = /^(.*) \((\d+)\)$/.exec(name) ?? [null, name, 1];
  const end = ` (${Number(count) + 1})`;
  return cut(base, MAX_NAME_BYTES - end.length) + end;
}

/** Time at which this tab was opened, and a random number to break ties. */
const me = [performance.timeOrigin, Math.random()];
const wasBefore = ([at, random]) => me[0] < at || (me[0] === at && me[1] < random);

const tabs = new BroadcastChannel('wsg.names');

tabs.onmessage = ({ data: { asks, taken, tab } }) => {
  if (asks === myName.peek()) {
    if (wasBefore(tab)) tabs.postMessage({ taken: asks, tab });
    else myName.value = another(asks);
  } else if (taken === myName.peek() && tab[1] === me[1]) {
    myName.value = another(taken);
  }
};

effect(() => tabs.postMessage({ asks: myName.value, tab: me }));
