// Keeps the keyboard focus in place when the focused button disappears or is disabled, for example "Take control".

/** Focused button, and its panel. */
let last = null;
let panel = null;

/** Returns the focus to a button that is enabled again, or to the panel's title if the button has disappeared. */
function restore() {
  if (last === null || document.activeElement !== document.body) return;
  if (last.isConnected) {
    if (!last.disabled) last.focus({ preventScroll: true });
  } else if (panel?.isConnected) {
    last = null;
    panel.querySelector('h2')?.focus({ preventScroll: true });
  }
}

/** Watches all buttons of the page. */
export function keepFocus(app) {
  addEventListener('focusin', ({ target }) => {
    last = target.closest('button');
    panel = target.closest('.panel');
  });

  addEventListener('focusout', ({ target }) => {
    // If the button is still usable, the user has moved the focus. The check waits until the page has changed.
    setTimeout(() => {
      if (target === last && target.isConnected && !target.disabled) last = null;
    });
  });
  new MutationObserver(restore).observe(app, {
    subtree: true,
    childList: true,
    attributeFilter: ['disabled'],
  });
}
