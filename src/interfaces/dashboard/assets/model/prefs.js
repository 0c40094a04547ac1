// What this browser keeps: its name, its language, its looks, and presets. Nothing of it leaves the browser but the name.

import { computed, effect, signal } from '../lib.js';

const PREFIX = 'wsg.';

function read(key, fallback) {
  try {
    return JSON.parse(localStorage.getItem(PREFIX + key)) ?? fallback;
  } catch {
    return fallback;
  }
}

function write(key, value) {
  try {
    localStorage.setItem(PREFIX + key, JSON.stringify(value));
  } catch {
    // A private window: it lasts as long as the page.
  }
}

/** A signal that outlives the page, where the browser lets it. What all tabs are to have at once is shared. */
export function kept(key, fallback, { isShared = false } = {}) {
  const value = signal(read(key, fallback));
  effect(() => write(key, value.value));
  if (isShared)
    addEventListener('storage', (event) => {
      if (event.key === PREFIX + key) value.value = read(key, fallback);
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

/** What is drawn by script has to be drawn anew with it. */
export const isDark = computed(() => (theme.value === 'auto' ? isDarkOutside.value : theme.value === 'dark'));

effect(() => {
  document.documentElement.dataset.theme = isDark.value ? 'dark' : 'light';
});

export const onLossMoving = kept('on_loss_moving', 'fast_stop');
export const onLossHolding = kept('on_loss_holding', 'keep');

/** By gripper: `[{name, width, speed, force}]`. */
export const presets = kept('presets', {}, { isShared: true });

/** Changes those of one gripper, as they are kept now: another tab may just have changed them, too. */
export function changePresets(gripper, change) {
  const all = read('presets', presets.peek());
  presets.value = { ...all, [gripper]: change(all[gripper] ?? []) };
}
