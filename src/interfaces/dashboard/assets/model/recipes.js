// The recipes of the gateway, read again after each change by anybody.

import { signal } from '../lib.js';
import { rpc } from './wire.js';

/** Delay of a reading, because an import is many changes. */
const READ_AFTER_MS = 200;

/** The recipes, by number; null until they are known. */
export const recipes = signal(null);

/** Whether the page shows recipes, or has shown them. */
let isWanted = false;

/** The reading under way, and whether another one has to follow. */
let reading = null;
let isStale = false;

async function read() {
  while (isStale) {
    isStale = false;
    try {
      recipes.value = (await rpc.call('recipes')).recipes;
    } catch {
      // A new connection reads them again.
    }
  }
  reading = null;
}

/** Reads the recipes. Readings follow each other, so that a late answer replaces no newer one. */
export function loadRecipes() {
  isWanted = true;
  isStale = true;
  reading ??= read();
  return reading;
}

let isScheduled = false;

/** Notes a change by anybody. Only a page that shows recipes reads them again. */
export function takeRecipeChange() {
  if (!isWanted || isScheduled) return;
  isScheduled = true;
  setTimeout(() => {
    isScheduled = false;
    loadRecipes();
  }, READ_AFTER_MS);
}
