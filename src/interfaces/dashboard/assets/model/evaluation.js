// Numbers of grips, read from the journal.

import { perPart } from '../core/statistics.js';
import { get, query } from '../net/rest.js';

/** Maximum number of grips that the gateway returns in a page. */
const MAX_GRIPS = 1000;

/** Reads the grips that match the filters. `isAll` is true if these are all of them. */
export async function evaluate(filters) {
  const { grips, next_cursor: next } = await get(`grips?${query({ ...filters, kind: 'grip', limit: MAX_GRIPS })}`);
  return { parts: perPart(grips), count: grips.length, isAll: !next };
}
