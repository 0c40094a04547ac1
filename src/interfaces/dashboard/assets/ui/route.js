// Keeps the gripper and the view in the address, so that users can save and share it.

import { effect } from '../lib.js';
import { shownGripper, selected, view, VIEWS } from '../model/state.js';

function read() {
  const [, name, wanted] = location.hash.split('/');
  try {
    if (name) selected.value = decodeURIComponent(name);
  } catch {
    // An invalid address is ignored.
  }
  if (VIEWS.includes(wanted)) view.value = wanted;
}

/** Opens a view, at its top. */
export function go(wanted = view.peek() === 'all' ? 'operate' : view.peek()) {
  if (wanted !== view.peek()) scrollTo(0, 0);
  view.value = wanted;
}

export function start() {
  read();
  addEventListener('hashchange', read);
  let isFirst = true;
  const write = () => {
    if (!shownGripper.peek()) return;
    const address = `#/${encodeURIComponent(shownGripper.peek().name)}/${view.peek()}`;
    // The browser's Back button returns to the previous view.
    if (location.hash !== address) history[isFirst ? 'replaceState' : 'pushState'](null, '', address);
    isFirst = false;
  };
  effect(() => {
    // A change of gripper and view together is one step of the history.
    if (shownGripper.value && view.value) queueMicrotask(write);
  });
}
