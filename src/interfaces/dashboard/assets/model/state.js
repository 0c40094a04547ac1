// The page's state: the grippers, the shown one, the view and the connection.

import { computed, signal } from '../lib.js';
import { Gripper } from './gripper.js';

export const VIEWS = ['operate', 'history', 'log', 'device', 'all'];

export const grippers = signal([]);
export const selected = signal(null);
export const view = signal('operate');
/** See `connectionAfter`. */
export const connection = signal('connecting');
/** The gateway's time of the newest message. */
export const heardAt = signal(null);
/** The gateway's time in whole seconds, for ages. */
export const now = signal(Date.now());
/** Grippers of all gateways; null until they are known. */
export const fleet = signal(null);
export const hasOthers = computed(() => new Set(fleet.value?.map(({ gateway }) => gateway)).size > 1);
/**
 * Recently active clients: `{subject, label, door, at}` by subject and label. Not a signal, because busy cells would
 * change it all the time.
 */
export const others = new Map();

const byName = new Map();

export const isLive = computed(() => connection.value === 'live');
/** Selected gripper, or null if this gateway no longer serves it. Never replaced by another one. */
export const shownGripper = computed(() => grippers.value.find(({ name }) => name === selected.value) ?? null);

export const find = (name) => byName.get(name);

/** Returns a gripper, which is new if the page does not know it yet. */
export function ensure(name) {
  if (!byName.has(name)) {
    byName.set(name, new Gripper(name));
    grippers.value = [...byName.values()].sort((a, b) => a.name.localeCompare(b.name, 'en', { numeric: true }));
  }
  return byName.get(name);
}

/** Drops grippers that the gateway no longer serves. */
export function keepOnly(names) {
  for (const name of byName.keys()) if (!names.includes(name)) byName.delete(name);
  grippers.value = grippers.peek().filter(({ name }) => byName.has(name));
  selected.value ??= grippers.peek()[0]?.name ?? null;
}
