// Labels of an axis.

/** Most decimals of a label. */
export const MAX_DECIMALS = 2;

/** Decimals that show each multiple of a step without rounding: 2 for 0.25. */
export function decimals(step) {
  const isWhole = (value) => Math.abs(value - Math.round(value)) < 1e-6;
  const enough = Array.from({ length: MAX_DECIMALS }, (_, count) => count).find((count) => isWhole(step * 10 ** count));
  return enough ?? MAX_DECIMALS;
}
