// Exports the journal's records as a CSV file, page after page.

import { spreadsheetTable } from '../core/csv.js';
import { language } from '../model/i18n.js';
import { query, text } from '../net/rest.js';

const PAGE = 1000;
/** A size that browsers and spreadsheets handle with ease. */
const MAX_PAGES = 50;

/** Saves a text as a file. */
export function save(name, content, type) {
  const address = URL.createObjectURL(new Blob([content], { type }));
  const link = document.createElement('a');
  link.href = address;
  link.download = name;
  link.click();
  URL.revokeObjectURL(address);
}

/**
 * Saves the records that match the filters, newest first: for a spreadsheet in the page's language, or for programs
 * (`isPlain`) as the gateway returns them. Returns their number, and whether these were all.
 */
export async function download(what, filters, isPlain) {
  let content = '';
  let cursor = null;
  let pages = 0;
  do {
    const page = await text(`${what}?${query({ ...filters, limit: PAGE, cursor })}`, 'text/csv');
    content += cursor === null ? page.text : page.text.slice(page.text.indexOf('\n') + 1);
    cursor = page.next;
    pages += 1;
  } while (cursor && pages < MAX_PAGES);
  const table = isPlain ? content : spreadsheetTable(content, language.peek());
  save(`${filters.gripper || 'all'}-${what}${isPlain ? '-plain' : ''}.csv`, table, 'text/csv');
  return { count: Math.max(0, content.trimEnd().split('\n').length - 1), isAll: !cursor };
}
