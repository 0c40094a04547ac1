// A notice moves the page below it. A tap that was meant for what stood there before must not move the fingers.

/** Time within which a person cannot have seen the change. */
const REACTS_AFTER_MS = 300;

/** Timer that runs while the page has just moved, or null. */
let moved = null;

/** Notes that the place of the notices has changed its size, and marks it for a while. */
export function noteMove(place) {
  clearTimeout(moved);
  place.dataset.moved = '';
  moved = setTimeout(() => {
    moved = null;
    delete place.dataset.moved;
  }, REACTS_AFTER_MS);
}

/** Buttons that move the fingers. Stops always act. */
const MOTIONS = '#grip, #release, #move, #home, .hold, .steps button';

const isMotion = (target) => target.closest?.(MOTIONS) != null;

/** Whether the newest press was too early, so that its click is too. */
let isEarly = false;

function ward(event) {
  // Keys and screen readers follow their button: their clicks have no detail.
  if (event.type === 'click' && event.detail === 0) return;
  const isNow = moved !== null;
  if (event.type === 'pointerdown') isEarly = isNow;
  if (!(isEarly || isNow) || !isMotion(event.target)) return;
  event.preventDefault();
  event.stopPropagation();
}

for (const type of ['pointerdown', 'click']) addEventListener(type, ward, { capture: true });
