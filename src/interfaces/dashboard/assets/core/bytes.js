// The gateway limits texts by their bytes in UTF-8, not by characters.

const encoder = new TextEncoder();

export const bytesOf = (text) => encoder.encode(text).length;

/** Cuts a text to the limit, between characters. */
export function cut(text, maxBytes) {
  const room = new Uint8Array(maxBytes);
  return text.slice(0, encoder.encodeInto(text, room).read);
}
