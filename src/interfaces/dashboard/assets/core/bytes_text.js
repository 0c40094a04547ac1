// Bytes as text: input of the command editor, and the meaning of selected bytes.

import { readings } from './limits.js';

/**
 * One token of the editor: "text", a hexadecimal or decimal number, or a float with an f. A comma right after a token
 * separates it from the next one.
 */
const TOKEN =
  /(?:(?<=[^\s,]),\s*|\s*)(?:"((?:[^"\\]|\\.)*)"(?![^\s,])|(0x[0-9a-f]+)(?![^\s,])|([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[+-]?\d+)?f)(?![^\s,])|([+-]?\d+)(?![^\s,])|([^\s,]+|,))/giy;

function littleEndian(hex) {
  const even = hex.length % 2 ? `0${hex}` : hex;
  return (even.match(/../g) ?? []).map((digits) => Number.parseInt(digits, 16)).reverse();
}

function float(text) {
  const bytes = new Uint8Array(4);
  new DataView(bytes.buffer).setFloat32(0, Number.parseFloat(text.replace(',', '.')), true);
  return bytes;
}

/**
 * Parses a text like `0x20 150.0f "text" 7`. A hexadecimal number has one byte for each pair of digits, little endian.
 * A decimal number from -128 to 255 has one byte, a float has four, and a text has one for each character. `wrong` is
 * the first invalid part, or null.
 */
export function parse(text) {
  const bytes = [];
  const trimmed = text.trim();
  TOKEN.lastIndex = 0;
  while (TOKEN.lastIndex < trimmed.length) {
    const match = TOKEN.exec(trimmed);
    if (!match) return { bytes, wrong: trimmed };
    const [, quoted, hex, single, decimal, other] = match;
    if (quoted !== undefined) {
      const plain = quoted.replace(/\\(.)/g, '$1');
      const codes = Array.from(plain, (character) => character.codePointAt(0));
      if (codes.some((code) => code > 0xff)) return { bytes, wrong: quoted };
      bytes.push(...codes);
    } else if (hex !== undefined) {
      bytes.push(...littleEndian(hex.slice(2)));
    } else if (single !== undefined) {
      // As in other fields, 1,000 is rejected: the comma can be a decimal or a thousands separator.
      if (single.includes(',') && readings(single.slice(0, -1)) !== null) return { bytes, wrong: single };
      bytes.push(...float(single));
    } else if (decimal !== undefined && Number(decimal) >= -0x80 && Number(decimal) <= 0xff) {
      bytes.push(Number(decimal) & 0xff);
    } else {
      return { bytes, wrong: other ?? decimal };
    }
  }
  return { bytes, wrong: null };
}

/** Parses a command id, a number or in the manual's notation (`31h`). Returns null if the text is not valid. */
export function parseId(text) {
  const trimmed = text.trim().toLowerCase();
  const manual = /^([0-9a-f]{2})h$/.exec(trimmed);
  const value = manual
    ? Number.parseInt(manual[1], 16)
    : /^(0x[0-9a-f]{1,2}|\d{1,3})$/.test(trimmed)
      ? Number(trimmed)
      : NaN;
  return value >= 0 && value <= 0xff ? value : null;
}

/** Values of the bytes, as each type of their length. */
export function interpretations(bytes) {
  const view = new DataView(Uint8Array.from(bytes).buffer);
  const values = [];
  const add = (type, value) => values.push({ type, value });
  switch (bytes.length) {
    case 1:
      add('u8', view.getUint8(0));
      add('i8', view.getInt8(0));
      break;
    case 2:
      add('u16', view.getUint16(0, true));
      add('i16', view.getInt16(0, true));
      break;
    case 4:
      add('f32', view.getFloat32(0, true));
      add('u32', view.getUint32(0, true));
      add('i32', view.getInt32(0, true));
      break;
    default:
  }
  add(
    'text',
    Array.from(bytes, (byte) => (byte >= 0x20 && byte < 0x7f ? String.fromCharCode(byte) : '\u00b7')).join(''),
  );
  return values;
}
