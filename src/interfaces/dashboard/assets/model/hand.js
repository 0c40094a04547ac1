// Values of Grip and Release at each gripper: those by hand, or the recipe that a person chose last.

import { signal } from '../lib.js';
import { asTyped, number, widthLimits } from '../core/limits.js';
import { openTo } from './prefs.js';
import { recipes } from './recipes.js';

/** Input for each gripper, kept while the page is open. */
const typed = new WeakMap();

/** Distance by which Release opens beyond the part's width, unless the user types another width. */
const OPENS_BY_MM = 10;

/** The part's width plus `OPENS_BY_MM`, within the limits; null while the part's width is not valid. */
export function defaultOpen(gripper, width) {
  const { max } = widthLimits(gripper.info.value, gripper.softLimits.value);
  const given = number(width.value);
  return Number.isFinite(given) ? Math.min(given + OPENS_BY_MM, max) : null;
}

/** Text of the field for the width to open to. The browser remembers the user's input. */
function openField(gripper, width) {
  return {
    get value() {
      return openTo.value[gripper.name] ?? asTyped(defaultOpen(gripper, width));
    },
    set value(text) {
      openTo.value = { ...openTo.peek(), [gripper.name]: text };
    },
  };
}

/** Signals of the values by hand, and `chosen`: the part of the chosen recipe, or null. */
export function handOf(gripper) {
  if (!typed.has(gripper)) {
    const width = signal('20');
    typed.set(gripper, {
      width,
      open: openField(gripper, width),
      speed: signal('50'),
      force: signal('30'),
      part: signal(''),
      direction: signal('default'),
      block: signal('stop'),
      chosen: signal(null),
    });
  }
  return typed.get(gripper);
}

/** The values of a recipe for a gripper: those of all grippers, with those of its own. */
export const valuesOfRecipe = (recipe, gripper) => ({ ...recipe, ...recipe.grippers[gripper.name] });

/** The recipe that a person chose last, or null. */
export function chosenRecipe(gripper) {
  const part = handOf(gripper).chosen.value;
  return part === null ? null : (recipes.value?.find((recipe) => recipe.part_id === part) ?? null);
}

/** Whether a recipe has the values of a grip, and of a release. */
export const canGrip = ({ width_mm: width, speed_mm_s: speed }) => width != null && speed != null;
export const canRelease = ({ release_width_mm: width, release_speed_mm_s: slow, speed_mm_s: speed }) =>
  width != null && (slow ?? speed) != null;
