// Detects that the gateway serves a newer version of this page: operators leave it open for weeks.

import { signal } from '../lib.js';
import { text } from '../net/rest.js';

/** `/assets/VERSION/` of this page. */
const OURS = new URL('.', document.currentScript.src).pathname;

export const isOld = signal(false);

let isFirst = true;

export async function lookForNewer() {
  // On its first connection, the page has just been loaded.
  if (isFirst) {
    isFirst = false;
    return;
  }
  try {
    const page = await text('/', 'text/html');
    isOld.value = !page.text.includes(OURS);
  } catch {
    // Tried again with the next connection.
  }
}
