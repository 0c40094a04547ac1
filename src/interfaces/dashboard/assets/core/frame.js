// The protocol's frame: AA AA AA | id | size | payload | checksum, all little endian.

const PREAMBLE = [0xaa, 0xaa, 0xaa];

/** Built from the polynomial 1021h: the manuals' printed tables are damaged. */
const TABLE = Uint16Array.from({ length: 256 }, (_, index) => {
  let crc = index << 8;
  for (let bit = 0; bit < 8; bit += 1) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  return crc & 0xffff;
});

/** Most payload bytes in a raw request. */
export const MAX_PAYLOAD = 4096;

/** Checksum of the bytes; 0 for a whole frame with its checksum. */
export function checksum(bytes) {
  let crc = 0xffff;
  for (const byte of bytes) crc = TABLE[(crc ^ byte) & 0xff] ^ (crc >> 8);
  return crc;
}

/** Builds a whole frame. */
export function encode(id, payload) {
  const bytes = [...PREAMBLE, id, payload.length & 0xff, payload.length >> 8, ...payload];
  const crc = checksum(bytes);
  return Uint8Array.from([...bytes, crc & 0xff, crc >> 8]);
}

/** Splits a frame into its parts. */
export function parts(bytes) {
  return {
    preamble: bytes.slice(0, 3),
    id: bytes[3],
    size: bytes[4] | (bytes[5] << 8),
    payload: bytes.slice(6, -2),
    checksum: bytes.slice(-2),
  };
}

export function fromHex(hex) {
  return Uint8Array.from(hex.match(/../g) ?? [], (digits) => Number.parseInt(digits, 16));
}

export function toHex(bytes, separator = '') {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, '0')).join(separator);
}
