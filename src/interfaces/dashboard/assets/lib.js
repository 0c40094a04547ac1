// Re-exports the vendored libraries.

import { h } from './vendor/preact.js';
import htm from './vendor/htm.js';

export { useEffect, useLayoutEffect, useMemo, useRef, useState, useId } from './vendor/hooks.js';
export {
  batch,
  computed,
  effect,
  signal,
  untracked,
  useComputed,
  useSignal,
  useSignalEffect,
} from './vendor/signals.js';
export { Fragment, render } from './vendor/preact.js';

export const html = htm.bind(h);
