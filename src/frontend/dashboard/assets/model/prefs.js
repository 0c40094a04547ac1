// What this browser keeps: its name, its language, its looks, and presets. Nothing of it leaves the browser but the name.

import { effect, signal } from '../lib.js';

const PREFIX = 'wsg.';

function read(key, fallback) {
  try {
    return JSON.parse(localStorage.getItem(PREFIX + key)) ?? fallback;
  } catch {
    return fallback;
  }
}

/** A signal that outlives the page, where the browser lets it. */
export function kept(key, fallback) {
  const value = signal(read(key, fallback));
  effect(() => {
    const text = JSON.stringify(value.value);
    try {
      localStorage.setItem(PREFIX + key, text);
    } catch {
      // A private window: it lasts as long as the page.
    }
  });
  return value;
}

const newName = () => `browser-${Array.from(crypto.getRandomValues(new Uint8Array(2)), (byte) => byte.toString(16).padStart(2, '0')).join('')}`;

/** By which it takes control: at most 32 bytes. */
export const myName = kept('name', newName());

/** `auto`, `light` or `dark`. */
export const theme = kept('theme', 'auto');

export const onLossMoving = kept('on_loss_moving', 'fast_stop');
export const onLossHolding = kept('on_loss_holding', 'keep');

/** By gripper: `[{name, width_mm, speed_mm_s, force_n}]`. */
export const presets = kept('presets', {});

effect(() => {
  document.documentElement.dataset.theme = theme.value;
});
