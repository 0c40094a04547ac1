// The gateway's limits of texts are in bytes of UTF-8, whatever a browser calls a character.

const encoder = new TextEncoder();

export const bytesOf = (text) => encoder.encode(text).length;

/** As much of a text as fits, without half a character. */
export function cut(text, maxBytes) {
  const room = new Uint8Array(maxBytes);
  return text.slice(0, encoder.encodeInto(text, room).read);
}
