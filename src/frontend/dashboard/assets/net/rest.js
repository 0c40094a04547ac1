// The REST API: JSON in and out, and a problem where something is refused.

import { noConnection } from './rpc.js';

const API = '/api/v1';

async function send(method, path, { body, accept = 'application/json', withinMs = 15000 } = {}) {
  const options = { method, headers: { accept }, cache: 'no-store', signal: AbortSignal.timeout(withinMs) };
  if (body !== undefined) options.body = JSON.stringify(body);
  let response;
  try {
    response = await fetch(path.startsWith('/') ? path : `${API}/${path}`, options);
  } catch {
    throw noConnection();
  }
  if (response.ok) return response;
  const problem = await response.json().catch(() => null);
  throw problem ?? { code: 'internal', detail: `HTTP ${response.status}`, status: response.status };
}

export async function get(path, options) {
  return (await send('GET', path, options)).json();
}

export async function post(path, body, options) {
  return (await send('POST', path, { ...options, body })).json();
}

/** Text, and where its next page begins. */
export async function text(path, accept) {
  const response = await send('GET', path, { accept });
  return { text: await response.text(), next: response.headers.get('next-cursor') };
}

/** A query, without what is empty. */
export function query(parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== '' && value !== null && value !== undefined);
  return new URLSearchParams(given).toString();
}
