// What a gripper can do, as the gateway knows it: nothing beyond is sent, and each field says between what it may be.

/** Where a device hasn't told its limits yet, none are known here: the gateway has the last word. */
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

/** What is wrong with a value: `missing`, `low`, `high`, or null. */
export function mistake(value, { min, max }) {
  if (value === null || value === undefined || !Number.isFinite(value)) return 'missing';
  if (value < min) return 'low';
  if (value > max) return 'high';
  return null;
}

/** A number that somebody typed, with a point or a comma; NaN where it is none, or may be another one as well. */
export function number(text) {
  const trimmed = String(text).trim().replace(',', '.');
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(trimmed) && readings(text) === null ? Number(trimmed) : NaN;
}

/** `1,000` and `5.000` are one number in English and another in German: both, or null where there is but one. */
export function readings(text) {
  const [, whole, rest] = /^\s*([+-]?[1-9]\d{0,2})[.,](\d{3})\s*$/.exec(text) ?? [];
  return whole === undefined ? null : [Number(`${whole}.${rest}`), Number(whole + rest)];
}

/** A value as it is put into a field: with no more decimals than can be read in one way only. */
export const asTyped = (value) => (value === null || value === undefined ? '' : String(Math.round(value * 100) / 100));
