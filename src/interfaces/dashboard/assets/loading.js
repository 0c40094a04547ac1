// Scripts that are loaded after the first screen (state and STOP): the rest of the operating view, then the library that
// draws plots, and the views that are opened less often with the first of them.

import { signal } from './lib.js';

/** Components of the operating view, by name; empty until they are loaded. */
export const laterParts = signal({});

/** Components of the other views, by name; empty until one of them is opened. */
export const otherViews = signal({});

/** The class that draws plots; null until it is loaded. */
export const plotClass = signal(null);

/** Whether a script could not be loaded. */
export const isMissing = signal(false);

// The second script is requested now that the first one is here. Earlier, its bytes would delay the first one on a slow
// network. Later, the controls would wait for the first screen, and then for a round trip.
{
  const second = document.createElement('link');
  second.rel = 'modulepreload';
  second.fetchPriority = 'low';
  second.href = new URL('later.js', document.currentScript.src).href;
  document.head.append(second);
}

export async function fetchLater() {
  try {
    laterParts.value = await import('./later.js');
    plotClass.value = (await import('./plots.js')).Plot;
  } catch {
    isMissing.value = true;
  }
}

export async function fetchViews() {
  try {
    otherViews.value = await import('./views.js');
  } catch {
    isMissing.value = true;
  }
}
