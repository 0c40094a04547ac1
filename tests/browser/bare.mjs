// A browser controlled through the DevTools protocol over a pipe, for measurements. Playwright would receive each
// WebSocket message as well, which costs as much as the page's own work.

import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

import { CHROMIUM, FLAGS, started } from './harness.mjs';

export async function bareBrowser({ width = 1280, height = 800 } = {}) {
  const profile = mkdtempSync(join(tmpdir(), 'wsg-browser-'));
  const flags = [
    ...FLAGS,
    '--headless',
    '--no-sandbox',
    '--remote-debugging-pipe',
    `--user-data-dir=${profile}`,
    `--window-size=${width},${height}`,
    'about:blank',
  ];
  const child = spawn(CHROMIUM, flags, { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
  const ended = new Promise((resolve) => {
    child.once('exit', resolve);
  });
  const waiting = new Map();
  let nextId = 1;
  let rest = '';
  child.stdio[4].setEncoding('utf8').on('data', (text) => {
    const messages = (rest + text).split('\0');
    rest = messages.pop();
    for (const message of messages.map((one) => JSON.parse(one))) {
      const { resolve, reject } = waiting.get(message.id) ?? {};
      waiting.delete(message.id);
      if (message.error) reject?.(new Error(message.error.message));
      else resolve?.(message.result);
    }
  });
  const send = (method, params = {}, sessionId = undefined) =>
    new Promise((resolve, reject) => {
      const id = nextId;
      nextId += 1;
      waiting.set(id, { resolve, reject });
      child.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId })}\0`);
    });
  started.push(async () => {
    await send('Browser.close').catch(() => {});
    await ended;
    rmSync(profile, { recursive: true, force: true });
  });

  /** Opens a page in a fresh browser context. */
  const open = async (url) => {
    const { browserContextId } = await send('Target.createBrowserContext');
    const { targetId } = await send('Target.createTarget', { url, browserContextId, width, height });
    const { sessionId } = await send('Target.attachToTarget', { targetId, flatten: true });
    const ask = (method, params) => send(method, params, sessionId);
    const evaluate = async (expression) =>
      (await ask('Runtime.evaluate', { expression, returnByValue: true, awaitPromise: true })).result.value;
    return { ask, evaluate, close: () => send('Target.disposeBrowserContext', { browserContextId }) };
  };
  return { send, open };
}
