// Keeps the keyboard's focus in its place when the focused button disappears or is disabled, as after "Take control".

/** Focused button, and its panel. */
let last = null;
let panel = null;

/** A button that is enabled again gets the focus back. The panel's title stands in for one that has disappeared. */
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
    // The user may have clicked elsewhere. A change of the page ends before this check.
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
