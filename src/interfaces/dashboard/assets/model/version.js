// Whether the gateway serves another page than this by now: an operator leaves it open for weeks.

import { signal } from '../lib.js';
import { text } from '../net/rest.js';

/** `/assets/VERSION/`, where this module came from. */
const OURS = new URL('..', import.meta.url).pathname;

export const isOld = signal(false);

let isFirst = true;

export async function lookForNewer() {
  // The first connection is made by a page that has just come.
  if (isFirst) {
    isFirst = false;
    return;
  }
  try {
    const page = await text('/', 'text/html');
    isOld.value = !page.text.includes(OURS);
  } catch {
    // With the next connection.
  }
}
