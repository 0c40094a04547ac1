// Keeps the keyboard focus in place when the focused element disappears ("Take control"), is disabled, or is covered
// with old values.

/** Focused element, and its panel. */
let last = null;
let panel = null;

/** Whether the element lost the focus while it was usable. */
let isLeft = false;

const isUsable = (one) => !one.matches(':disabled, [inert] *');

/** Returns the focus to an element that is usable again, or to the panel's title if the element has disappeared. */
function restore() {
  if (last === null || document.activeElement !== document.body) return;
  if (last.isConnected) {
    if (!isLeft && isUsable(last)) last.focus({ preventScroll: true });
  } else if (panel?.isConnected) {
    last = null;
    panel.querySelector('h2')?.focus({ preventScroll: true });
  } else if (panel !== null) {
    // The whole panel has disappeared, as that of an acknowledged FAST STOP.
    last = null;
    const title = document.getElementById('motion-title') ?? document.querySelector('main h2');
    title?.focus({ preventScroll: true });
  }
}

/** Watches the page. */
export function keepFocus(app) {
  addEventListener('focusin', ({ target }) => {
    last = target;
    panel = target.closest('.panel');
    isLeft = false;
  });

  addEventListener('focusout', ({ target }) => {
    if (target !== last || !isUsable(target)) return;
    isLeft = true;
    // Either the user has moved the focus, or the page is about to remove the element.
    setTimeout(() => {
      if (isLeft && target === last && target.isConnected) last = null;
    });
  });
  new MutationObserver(restore).observe(app, {
    subtree: true,
    childList: true,
    attributeFilter: ['disabled', 'inert'],
  });
}
