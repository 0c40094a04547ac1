// The REST API: JSON in and out, and a problem where something is refused.

import { noConnection } from './rpc.js';

const API = '/api/v1';

/** What an answer may take, and a thousand records. */
const ANSWERS_WITHIN_MS = 5000;
const RECORDS_WITHIN_MS = 20_000;

/** What is being read. A browser opens six connections to a host, and whatever else is asked for waits for one of them. */
const reading = new Set();

/** Why a read was given up, other than that it took too long. */
const GAVE_WAY = Symbol('gave way');

/** Gives up what is being read, so that there is a connection for what must not wait. */
function makeWay() {
  reading.forEach((one) => one.abort(GAVE_WAY));
}

/** An answer. What gave way is asked for again, behind what it gave way to. */
async function ask(...asked) {
  for (;;) {
    try {
      return await askOnce(...asked);
    } catch (problem) {
      if (problem !== GAVE_WAY) throw problem;
    }
  }
}

/** An answer, taken by `take` within the time that it may take as a whole. */
async function askOnce(
  take,
  method,
  path,
  { body, accept = 'application/json', withinMs = ANSWERS_WITHIN_MS, isUrgent = false } = {},
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
      headers: { accept },
      cache: 'no-store',
      signal: abort.signal,
      priority: isUrgent ? 'high' : 'auto',
    };
    if (body !== undefined) options.body = JSON.stringify(body);
    const response = await fetch(path.startsWith('/') ? path : `${API}/${path}`, options).catch(failed);
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

/** A request that waits for nothing that is being read. */
export function postUrgently(path, body, withinMs) {
  return ask(asJson, 'POST', path, { body, withinMs, isUrgent: true });
}

/** Text, and where its next page begins. */
export function text(path, accept) {
  const take = async (response) => ({ text: await response.text(), next: response.headers.get('next-cursor') });
  return ask(take, 'GET', path, { accept, withinMs: RECORDS_WITHIN_MS });
}

/** A query, without what is empty. */
export function query(parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== '' && value !== null && value !== undefined);
  return new URLSearchParams(given).toString();
}
