// Drops misplaced taps: the second click of a double click on a button that the first one has changed, and a tap on a
// notice that has just appeared. Stops always act.

/** Time within which a person cannot react to a change. */
const REACTS_WITHIN_MS = 500;

/** Distance in px within which two clicks are at the same place. */
const SAME_PLACE_PX = 24;

/** The newest click that was let through: its time, place, button, and the button's words then. */
let last = null;

/** The words of a button. A count in them can change. */
const wordsOf = (button) => (button.getAttribute('aria-label') ?? button.textContent).replace(/\d+/g, '');

const isStop = (button) => button.matches('.stop, .at-once, #stop-soft');

/** Whether a button is not the one that was at this place when the person last pressed. */
function isAnother(button, event) {
  if (last === null || event.timeStamp - last.at > REACTS_WITHIN_MS) return false;
  if (Math.hypot(event.clientX - last.x, event.clientY - last.y) > SAME_PLACE_PX) return false;
  return button !== last.button || wordsOf(button) !== last.words;
}

/** Timer that runs after a press. */
let pressed = null;

/** Marks the page for as long as another button at the same place cannot be pressed. */
function notePress() {
  clearTimeout(pressed);
  document.documentElement.dataset.pressed = '';
  pressed = setTimeout(() => delete document.documentElement.dataset.pressed, REACTS_WITHIN_MS);
}

addEventListener(
  'click',
  (event) => {
    // Clicks from keys and screen readers have a `detail` of 0. They always hit the intended button.
    if (event.detail === 0) return;
    const button = event.target.closest?.('button, a, summary');
    if (!button || isStop(button)) return;
    if (isAnother(button, event) || button.closest('.strip[data-fresh] .notice')) {
      event.preventDefault();
      event.stopPropagation();
      return;
    }
    last = { at: event.timeStamp, x: event.clientX, y: event.clientY, button, words: wordsOf(button) };
    notePress();
  },
  { capture: true },
);

// Jogging and steering begin with the press.
addEventListener(
  'pointerdown',
  (event) => {
    const hold = event.target.closest?.('.hold, .slider');
    if (!hold || !isAnother(hold, event)) return;
    event.preventDefault();
    event.stopPropagation();
  },
  { capture: true },
);
