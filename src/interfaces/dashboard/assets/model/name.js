// Name under which this tab takes control. Each tab is a client of its own: of two tabs with the same name, the older
// one keeps it, and the other gets a number.

import { computed, effect, signal } from '../lib.js';
import { cut } from '../core/bytes.js';
import { me } from './me.js';
import { kept } from './prefs.js';

/** The gateway's limit of a holder's name. */
export const MAX_NAME_BYTES = 32;

const SESSION = 'wsg.name';

/** Name for tabs that are opened later. */
const usual = kept('name', '');

function ofThisTab() {
  try {
    return sessionStorage.getItem(SESSION);
  } catch {
    return null;
  }
}

/** Names that earlier versions of this page made up. */
const isMadeUp = (name) => /^browser-[0-9a-f]{4}( \(\d+\))?$/.test(name);

/** The person's name; empty until it was asked for. */
export const myName = signal([ofThisTab(), usual.peek()].find((name) => name && !isMadeUp(name)) ?? '');

/** Name under which this page takes control: the person's, or that of the credential. Empty without both. */
export const holderName = computed(() => myName.value || (me.value?.name ?? ''));

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

/** Whether the person was not asked yet. */
export const isUnnamed = computed(() => holderName.value === '');

/** Returns the next name in the series `Anna`, `Anna (2)`, `Anna (3)`. */
export function another(name) {
  const [, base, count] = /^(.*) \((\d+)\)$/.exec(name) ?? [null, name, 1];
  const end = ` (${Number(count) + 1})`;
  return cut(base, MAX_NAME_BYTES - end.length) + end;
}

/** Time at which this tab was opened, and a random number to break ties. */
const thisTab = [performance.timeOrigin, Math.random()];
const wasBefore = ([at, random]) => thisTab[0] < at || (thisTab[0] === at && thisTab[1] < random);

const tabs = new BroadcastChannel('wsg.names');

tabs.onmessage = ({ data: { asks, taken, tab } }) => {
  if (myName.peek() === '') return;
  if (asks === myName.peek()) {
    if (wasBefore(tab)) tabs.postMessage({ taken: asks, tab });
    else myName.value = another(asks);
  } else if (taken === myName.peek() && tab[1] === thisTab[1]) {
    myName.value = another(taken);
  }
};

effect(() => {
  if (myName.value !== '') tabs.postMessage({ asks: myName.value, tab: thisTab });
});
