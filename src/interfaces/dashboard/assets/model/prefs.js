// Preferences stored in this browser: name, language, theme and terms of control.

import { computed, effect, signal } from '../lib.js';

/** `wsg.`, or `wsg/left.` below the path `/left/`: another gateway of this host can have a gripper of the same name. */
export const STORAGE_PREFIX = `wsg${new URL('.', location.href).pathname.slice(0, -1)}.`;

function read(key, fallback) {
  try {
    return JSON.parse(localStorage.getItem(STORAGE_PREFIX + key)) ?? fallback;
  } catch {
    return fallback;
  }
}

function write(key, value) {
  try {
    localStorage.setItem(STORAGE_PREFIX + key, JSON.stringify(value));
  } catch {
    // In a private window, the value lasts as long as the page.
  }
}

/** Returns a signal that is stored, if the browser permits. A shared one follows changes in other tabs. */
export function kept(key, fallback, { isShared = false } = {}) {
  const value = signal(read(key, fallback));
  effect(() => write(key, value.value));
  if (isShared)
    addEventListener('storage', (event) => {
      if (event.key === STORAGE_PREFIX + key) value.value = read(key, fallback);
    });
  return value;
}

/** `auto`, `light` or `dark`. */
export const theme = kept('theme', 'auto', { isShared: true });

const prefersDark = matchMedia('(prefers-color-scheme: dark)');
const isDarkOutside = signal(prefersDark.matches);
prefersDark.addEventListener('change', () => {
  isDarkOutside.value = prefersDark.matches;
});

/** Whether the page is dark. Plots are recreated on a change. */
export const isDark = computed(() => (theme.value === 'auto' ? isDarkOutside.value : theme.value === 'dark'));

effect(() => {
  document.documentElement.dataset.theme = isDark.value ? 'dark' : 'light';
});

export const onLossMoving = kept('on_loss_moving', 'fast_stop');
export const onLossHolding = kept('on_loss_holding', 'keep');

/** Width that Release opens to, as typed, by gripper. */
export const openTo = kept('open_to', {}, { isShared: true });
