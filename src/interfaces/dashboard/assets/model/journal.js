// Changes of the journal, after which the history reloads.

import { signal } from '../lib.js';

/** Changes come in bursts, which are counted as one. */
const COUNTED_EVERY_MS = 400;

export const journalChanges = signal(0);

let timer = null;

export function noteJournalChange() {
  if (timer !== null) return;
  timer = setTimeout(() => {
    timer = null;
    journalChanges.value += 1;
  }, COUNTED_EVERY_MS);
}
