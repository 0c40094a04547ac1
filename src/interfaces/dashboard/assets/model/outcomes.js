// The newest outcome of each recipe at each gripper. Events report those that come while the page is open.

import { signal } from '../lib.js';
import { get, query } from '../net/rest.js';
import { handOf } from './hand.js';
import { recipes } from './recipes.js';

/** Grips that are read to find the newest outcomes. */
const MAX_READ = 100;

/** By gripper: a signal of the newest outcome `{outcome, width_mm}` by the recipe's number. */
const outcomes = new WeakMap();

function of(gripper) {
  if (!outcomes.has(gripper)) outcomes.set(gripper, signal(new Map()));
  return outcomes.get(gripper);
}

export const outcomeOf = (gripper, number) => of(gripper).value.get(number) ?? null;

/** Notes the end of a grip, from its event or record. */
export function noteOutcome(gripper, { recipe, outcome, width_mm = null }) {
  if (recipe == null || !outcome) return;
  of(gripper).value = new Map(of(gripper).peek()).set(recipe, { outcome, width_mm });
}

/** Grippers whose outcomes were read. */
const known = new WeakSet();

/** Reads the outcomes, and chooses the recipe of the newest grip, so that Release knows how far to open. */
export async function loadOutcomes(gripper) {
  if (known.has(gripper)) return;
  known.add(gripper);
  try {
    const { grips } = await get(`grips?${query({ gripper: gripper.name, kind: 'grip', limit: MAX_READ })}`);
    const before = of(gripper).peek();
    [...grips].reverse().forEach((grip) => {
      if (!before.has(grip.recipe)) noteOutcome(gripper, grip);
    });
    const newest = recipes.peek()?.find(({ number }) => number === grips[0]?.recipe);
    const { chosen } = handOf(gripper);
    if (newest && chosen.peek() === null) chosen.value = newest.part_id;
  } catch {
    // Tried again when the recipes are shown again.
    known.delete(gripper);
  }
}
