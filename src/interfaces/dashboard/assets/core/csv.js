// Tables for spreadsheets, which read CSV in the form of their user's language.

/** A cell with its quotes, and what ends it. */
const CELL = /("(?:[^"]|"")*"|[^",\n]*)(,|\n|$)/g;

/** Columns of measured numbers, whose names end in a unit. Ids and versions can look like numbers, but are texts. */
const MEASURED = /_(mm|mm_s|mm_s2|m|n|ms)$/;

/** Begins a file that spreadsheets read as UTF-8. */
const BYTE_ORDER_MARK = '\uFEFF';

/** Rewrites a table of the gateway with the decimal sign of a language. Where that is a comma, semicolons separate. */
export function spreadsheetTable(table, language) {
  const decimal = new Intl.NumberFormat(language).format(1.5).charAt(1);
  if (decimal === '.') return BYTE_ORDER_MARK + table;
  const columns = table.split('\n', 1)[0].split(',');
  let column = 0;
  const rewritten = table.replace(CELL, (_, cell, end) => {
    const isMeasured = MEASURED.test(columns[column]);
    column = end === ',' ? column + 1 : 0;
    const quoted = cell.includes(';') && !cell.startsWith('"') ? `"${cell}"` : cell;
    return (isMeasured ? cell.replace('.', decimal) : quoted) + (end === ',' ? ';' : end);
  });
  return BYTE_ORDER_MARK + rewritten;
}
