// The REST API: JSON in and out. A refusal rejects with a problem.

import { noConnection } from './rpc.js';

/** Relative to the page, which a proxy can serve below any path. */
const API = 'api/v1';

/** Time limits of an answer, and of a page of a thousand records. */
const ANSWERS_WITHIN_MS = 5000;
const RECORDS_WITHIN_MS = 20_000;

/** Reads in progress. A browser opens six connections to a host, and further requests wait for one of them. */
const reading = new Set();

/** Abort reason of a read that made way for an urgent request. */
const GAVE_WAY = Symbol('gave way');

/** Cancels all reads, so that an urgent request finds a free connection. */
function makeWay() {
  reading.forEach((one) => one.abort(GAVE_WAY));
}

/** A header's text: each character stands for one byte of its UTF-8. */
const headerText = (text) => String.fromCharCode(...new TextEncoder().encode(text));

/** Sends a request. A read that made way for an urgent request is sent again after it. */
async function ask(...asked) {
  for (;;) {
    try {
      return await askOnce(...asked);
    } catch (problem) {
      if (problem !== GAVE_WAY) throw problem;
    }
  }
}

/** Sends a request once. The time limit includes reading the response with `take`. */
async function askOnce(
  take,
  method,
  path,
  { body, label, accept = 'application/json', withinMs = ANSWERS_WITHIN_MS, isUrgent = false } = {},
) {
  if (isUrgent) makeWay();
  const abort = new AbortController();
  const tooLate = setTimeout(() => abort.abort(), withinMs);
  if (!isUrgent) reading.add(abort);
  const failed = () => {
    throw abort.signal.reason === GAVE_WAY ? GAVE_WAY : noConnection();
  };
  try {
    const options = {
      method,
      headers: label ? { accept, 'wsg-client': headerText(label) } : { accept },
      cache: 'no-store',
      signal: abort.signal,
      priority: isUrgent ? 'high' : 'auto',
    };
    if (body !== undefined) options.body = JSON.stringify(body);
    const response = await fetch(path.startsWith('/') ? `.${path}` : `${API}/${path}`, options).catch(failed);
    if (response.ok) return await take(response).catch(failed);
    const problem = await response.json().catch(() => (abort.signal.aborted ? failed() : null));
    throw problem ?? { code: 'internal', detail: `HTTP ${response.status}`, status: response.status };
  } finally {
    clearTimeout(tooLate);
    reading.delete(abort);
  }
}

const asJson = (response) => response.json();

export function get(path) {
  return ask(asJson, 'GET', path);
}

const asNothing = async () => null;

/** Sends a change. */
export function send(path, body) {
  return ask(asJson, 'POST', path, { body });
}

export function remove(path) {
  return ask(asNothing, 'DELETE', path);
}

/** Asks which methods a path has. Like a WebSocket, such a request names the page's origin. */
export function options(path) {
  return ask(asNothing, 'OPTIONS', path);
}

/** Sends a change that outlives the page. */
export function sendLast(path, body) {
  return fetch(`${API}/${path}`, { method: 'POST', body: JSON.stringify(body), keepalive: true, priority: 'high' });
}

/** Sends a request of the user `label`, which does not wait for reads. */
export function postUrgently(path, body, label, withinMs) {
  return ask(asJson, 'POST', path, { body, label, withinMs, isUrgent: true });
}

/** Reads a text, and the cursor of its next page. */
export function text(path, accept) {
  const take = async (response) => ({ text: await response.text(), next: response.headers.get('next-cursor') });
  return ask(take, 'GET', path, { accept, withinMs: RECORDS_WITHIN_MS });
}

/** Query string, without empty parameters. */
export function query(parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== '' && value !== null && value !== undefined);
  return new URLSearchParams(given).toString();
}
