// Blocks misplaced taps. A notice moves the page below it, and a tap aimed at the earlier content must not move the
// fingers.

/** Time within which a person cannot react to the change. */
const REACTS_AFTER_MS = 300;

/** Timer that runs while the page has just moved, or null. */
let moved = null;

/** Notes that the area of the notices has changed its size, and marks the area for a while. */
export function noteMove(place) {
  clearTimeout(moved);
  place.dataset.moved = '';
  moved = setTimeout(() => {
    moved = null;
    delete place.dataset.moved;
  }, REACTS_AFTER_MS);
}

/** Buttons that move the fingers. Stops always act. */
const MOTIONS = '#grip, #release, #move, #home, .hold, .steps button, .recipe-buttons [data-act^="command."]';

const isMotion = (target) => target.closest?.(MOTIONS) != null;

/** Whether the newest press came too early, so that its click is blocked as well. */
let isEarly = false;

function ward(event) {
  // Clicks from keys and screen readers have a `detail` of 0. They always hit the intended button.
  if (event.type === 'click' && event.detail === 0) return;
  const isNow = moved !== null;
  if (event.type === 'pointerdown') isEarly = isNow;
  if (!(isEarly || isNow) || !isMotion(event.target)) return;
  event.preventDefault();
  event.stopPropagation();
}

for (const type of ['pointerdown', 'click']) addEventListener(type, ward, { capture: true });
