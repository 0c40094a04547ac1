// A gripper's limits, as the gateway reports them. Fields show them, and values beyond them are not sent.

/** Limits of a device that has not reported its own yet. The gateway checks every value in any case. */
const UNKNOWN = { min: 0, max: Infinity, whose: null };

export function widthLimits(info, soft) {
  if (info?.stroke_mm == null) return UNKNOWN;
  if (soft?.minus_mm == null) return { min: 0, max: info.stroke_mm, whose: 'device' };
  return { min: Math.max(0, soft.minus_mm), max: Math.min(info.stroke_mm, soft.plus_mm), whose: 'soft' };
}

export function speedLimits(info) {
  if (info?.max_speed_mm_s == null) return UNKNOWN;
  return { min: info.min_speed_mm_s, max: info.max_speed_mm_s, whose: 'device' };
}

export function forceLimits(info, overdrive) {
  if (info?.nominal_force_n == null) return UNKNOWN;
  const isOver = overdrive && info.overdrive_force_n > info.nominal_force_n;
  return {
    min: info.min_force_n,
    max: isOver ? info.overdrive_force_n : info.nominal_force_n,
    whose: isOver ? 'overdrive' : 'device',
  };
}

export function accelerationLimits(info) {
  if (info?.max_acceleration_mm_s2 == null) return UNKNOWN;
  return { min: info.min_acceleration_mm_s2, max: info.max_acceleration_mm_s2, whose: 'device' };
}

/** Returns why a value is not valid (`missing`, `low` or `high`), or null. */
export function mistake(value, { min, max }) {
  if (value === null || value === undefined || !Number.isFinite(value)) return 'missing';
  if (value < min) return 'low';
  if (value > max) return 'high';
  return null;
}

/** Parses typed text with a decimal point or comma; NaN if it is not a number, or an ambiguous one. */
export function number(text) {
  const trimmed = String(text).trim().replace(',', '.');
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(trimmed) && readings(text) === null ? Number(trimmed) : NaN;
}

/** Returns both readings of a text like `1,000`, which differ in English and German; null if there is only one. */
export function readings(text) {
  const [, whole, rest] = /^\s*([+-]?[1-9]\d{0,2})[.,](\d{3})\s*$/.exec(text) ?? [];
  return whole === undefined ? null : [Number(`${whole}.${rest}`), Number(whole + rest)];
}

/** Parses an optional field that began with `value`; undefined if it is empty. An unchanged text keeps all decimals. */
export function typedFrom(value, text) {
  if (text.trim() === '') return undefined;
  return text === asTyped(value) ? value : number(text);
}

/** Formats a value for a field, with two decimals at most: a third would make it ambiguous. */
export const asTyped = (value) => (value === null || value === undefined ? '' : String(Math.round(value * 100) / 100));
