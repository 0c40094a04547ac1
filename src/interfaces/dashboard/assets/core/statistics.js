// Numbers of grips, per part. Pure functions, so that they can be tested.

const HELD = 'PART_HELD';

/** Mean, spread (standard deviation of a sample) and trend (newer half minus older half) of values, newest first. */
export function summary(values) {
  const known = values.filter((value) => value !== null && value !== undefined);
  const mean = (list) => (list.length === 0 ? null : list.reduce((sum, value) => sum + value, 0) / list.length);
  const middle = mean(known);
  const squares = known.map((value) => (value - middle) ** 2);
  const half = Math.floor(known.length / 2);
  return {
    mean: middle,
    spread: known.length < 2 ? null : Math.sqrt((mean(squares) * known.length) / (known.length - 1)),
    trend: half === 0 ? null : mean(known.slice(0, half)) - mean(known.slice(known.length - half)),
  };
}

/** Weight of the newest value in a moving average, as in the gateway. */
const NEWEST_WEIGHS = 0.2;

/** Exponentially weighted moving averages of values, oldest first. */
export function averages(values) {
  let average = values[0];
  return values.map((value) => {
    average += NEWEST_WEIGHS * (value - average);
    return average;
  });
}

/** Maximum number of bars of a histogram. */
const MAX_BARS = 20;
/** Width of the only bar if all values are the same: the resolution of widths, in mm. */
const RESOLUTION_MM = 0.01;

/** Bars of equal width that cover all values: `from`, `to` and the number of values within. */
export function histogram(values) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const bars = least === most ? 1 : Math.min(MAX_BARS, Math.ceil(Math.sqrt(values.length)));
  const width = least === most ? RESOLUTION_MM : (most - least) / bars;
  const from = least === most ? least - RESOLUTION_MM / 2 : least;
  const counts = Array(bars).fill(0);
  for (const value of values) counts[Math.min(bars - 1, Math.floor((value - from) / width))] += 1;
  return counts.map((count, index) => ({ from: from + index * width, to: from + (index + 1) * width, count }));
}

/** Groups grips, newest first, by part: the grips, count, share of held parts, and width and force of the held ones. */
export function perPart(grips) {
  const groups = new Map();
  for (const grip of grips) {
    const part = grip.part_id ?? null;
    groups.set(part, [...(groups.get(part) ?? []), grip]);
  }
  return Array.from(groups, ([part, all]) => {
    const held = all.filter(({ outcome, part_lost_at }) => outcome === HELD && !part_lost_at);
    return {
      part,
      grips: all,
      count: all.length,
      rate: held.length / all.length,
      width: summary(held.map(({ width_mm }) => width_mm)),
      force: summary(held.map(({ force_n }) => force_n)),
    };
  }).sort((a, b) => b.count - a.count || String(a.part).localeCompare(String(b.part), 'en', { numeric: true }));
}
