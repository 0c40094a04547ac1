// Which view of which gripper: in the address, so that it can be kept and sent.

import { effect } from '../lib.js';
import { gripper, selected, view, VIEWS } from '../model/store.js';

function read() {
  const [, name, wanted] = location.hash.split('/');
  try {
    if (name) selected.value = decodeURIComponent(name);
  } catch {
    // An address that names nothing: the page is there all the same.
  }
  if (VIEWS.includes(wanted)) view.value = wanted;
}

export function go(wanted = view.peek() === 'all' ? 'operate' : view.peek()) {
  view.value = wanted;
}

export function start() {
  read();
  addEventListener('hashchange', read);
  effect(() => {
    if (!gripper.value) return;
    const address = `#/${encodeURIComponent(gripper.value.name)}/${view.value}`;
    if (location.hash !== address) history.replaceState(null, '', address);
  });
}
