// Number of connected clients by interface, from the gateway's metrics.

import { signal } from '../lib.js';
import { text } from '../net/rest.js';
import { isLive } from '../model/store.js';

const ASKED_EVERY_MS = 5000;
const LINE = /^wsg_clients_connected\{door="(\w+)"\} (\d+)/gm;

export const clients = signal([]);

async function ask() {
  if (!isLive.peek() || document.hidden) return;
  try {
    const { text: figures } = await text('/metrics', 'text/plain');
    clients.value = Array.from(figures.matchAll(LINE), ([, door, count]) => ({ door, count: Number(count) })).filter(
      ({ count }) => count > 0,
    );
  } catch {
    clients.value = [];
  }
}

/** Polls until the returned function is called. */
export function watchClients() {
  ask();
  const timer = setInterval(ask, ASKED_EVERY_MS);
  return () => clearInterval(timer);
}
