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

/** Groups grips, newest first, by part: count, share of held parts, and width and force of the held ones. */
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
      count: all.length,
      rate: held.length / all.length,
      width: summary(held.map(({ width_mm }) => width_mm)),
      force: summary(held.map(({ force_n }) => force_n)),
    };
  }).sort((a, b) => b.count - a.count || String(a.part).localeCompare(String(b.part), 'en', { numeric: true }));
}
