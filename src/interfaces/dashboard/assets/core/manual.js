// Commands of the manuals, and the fields of their parameters. All numbers are little endian.

/** A field: key of its text, type, and unit. Types are `f32`, `u8`, `u16`, and `text` for the rest of the bytes. */
const field = (key, type, unit = '') => ({ key, type, unit });
const mm = (key) => field(key, 'f32', 'mm');
const SPEED = field('speed', 'f32', 'mm/s');
const FORCE = field('force', 'f32', 'N');
const FLAGS = field('editor.flags', 'u8');
const UPDATES = [FLAGS, field('editor.period', 'u16', 'ms')];
const SWITCH = [field('editor.switch', 'u8')];

/** Name and fields, by id. */
export const MANUAL = new Map([
  [0x06, ['Loop', [field('editor.data', 'text')]]],
  [0x07, ['DisconnectAnnouncement', []]],
  [0x20, ['Homing', [field('field.direction', 'u8')]]],
  [0x21, ['PrePosition', [FLAGS, mm('width'), SPEED]]],
  [0x22, ['Stop', []]],
  [0x23, ['FastStop', []]],
  [0x24, ['AcknowledgeFastStop', [field('editor.data', 'text')]]],
  [0x25, ['Grip', [mm('width'), SPEED]]],
  [0x26, ['Release', [mm('width'), SPEED]]],
  [0x30, ['SetAcceleration', [field('settings.acceleration', 'f32', 'mm/s²')]]],
  [0x31, ['GetAcceleration', []]],
  [0x32, ['SetForceLimit', [FORCE]]],
  [0x33, ['GetForceLimit', []]],
  [0x34, ['SetSoftLimits', [mm('settings.minus'), mm('settings.plus')]]],
  [0x35, ['GetSoftLimits', []]],
  [0x36, ['ClearSoftLimits', []]],
  [0x37, ['OverdriveMode', SWITCH]],
  [0x38, ['TareForceSensor', []]],
  [0x40, ['GetSystemState', UPDATES]],
  [0x41, ['GetGripperState', UPDATES]],
  [0x42, ['GetStatistics', [FLAGS]]],
  [0x43, ['GetWidth', UPDATES]],
  [0x44, ['GetSpeed', UPDATES]],
  [0x45, ['GetForce', UPDATES]],
  [0x46, ['GetTemperature', []]],
  [0x50, ['GetSystemInfo', []]],
  [0x51, ['SetDeviceTag', [field('settings.tag', 'text')]]],
  [0x52, ['GetDeviceTag', []]],
  [0x53, ['GetSystemLimits', []]],
  [0x60, ['GetFinger1Info', []]],
  [0x61, ['GetFinger1Flags', []]],
  [0x62, ['Finger1Power', SWITCH]],
  [0x63, ['GetFinger1Data', []]],
  [0x70, ['GetFinger2Info', []]],
  [0x71, ['GetFinger2Flags', []]],
  [0x72, ['Finger2Power', SWITCH]],
  [0x73, ['GetFinger2Data', []]],
]);

export const fieldsOf = (id) => MANUAL.get(id)?.[1] ?? [];

/** An id in the manuals' notation, such as `31h`. */
export const idText = (id) => `${id.toString(16).padStart(2, '0').toUpperCase()}h`;

const hex = (value, digits) => `0x${value.toString(16).padStart(digits, '0')}`;

function written(type, text) {
  const typed = text.trim();
  if (type === 'text') return `"${text.replace(/["\\]/g, '\\$&')}"`;
  if (type === 'f32') return `${typed}f`;
  // The editor reads the same texts, and reports those that are not valid.
  return type === 'u16' && /^\d{1,5}$/.test(typed) ? hex(Number(typed), 4) : typed;
}

/** Writes the values of a form as a text for the editor. An empty field has no bytes. */
export function compose(fields, values) {
  return fields.flatMap(({ type }, index) => (values[index] ? [written(type, values[index])] : [])).join(' ');
}

const SIZES = { f32: 4, u16: 2, u8: 1 };

function read(type, bytes) {
  if (type === 'text') return String.fromCharCode(...bytes);
  const view = new DataView(Uint8Array.from(bytes).buffer);
  if (type === 'f32') return String(Math.round(view.getFloat32(0, true) * 1e4) / 1e4);
  return String(type === 'u16' ? view.getUint16(0, true) : view.getUint8(0));
}

/** Reads the values of a form from bytes. A field whose bytes are missing is empty. */
export function valuesOf(fields, bytes) {
  let from = 0;
  return fields.map(({ type }) => {
    const size = SIZES[type] ?? bytes.length - from;
    const mine = bytes.slice(from, from + size);
    from += size;
    return mine.length < size || size === 0 ? '' : read(type, mine);
  });
}
