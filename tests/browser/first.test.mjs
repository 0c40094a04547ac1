// The first load, and a single widget.

import assert from 'node:assert/strict';
import { createServer } from 'node:http';
import { test } from 'node:test';

import { places } from './checks.mjs';
import { assertClean, browser, gateway, homed, LONGER_TIMES, rendered, started, until, visit } from './harness.mjs';

const launched = await browser();

const MOST_REQUESTS = 10;
const MOST_BYTES = 120_000;

test('the first load needs few requests', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/readyz', hasOwnTimes: true });
  const { page } = visitor;
  const asked = [];
  page.on('request', (request) => asked.push(request.url()));
  const sizes = [];
  page.on('response', async (response) => sizes.push(Number((await response.request().sizes()).responseBodySize)));
  await page.goto(served.url);
  await page.waitForSelector('#take-control');
  await page.waitForSelector('.charts-panel canvas');
  await page.waitForLoadState('networkidle');
  const bytes = sizes.reduce((sum, size) => sum + size, 0);
  console.log(`${asked.length} requests, ${bytes} bytes`);
  assert.ok(asked.length <= MOST_REQUESTS, asked.join('\n'));
  assert.ok(bytes <= MOST_BYTES, `${bytes} bytes`);
  const address = await page.locator('link[rel=manifest]').evaluate(({ href }) => href);
  const { start_url } = await (await fetch(address)).json();
  assert.equal(new URL(start_url, address).href, `${served.url}/`);
  assertClean(visitor);
});

test('the second script is requested when the first one arrives, and not earlier', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/readyz', hasOwnTimes: true });
  const { page } = visitor;
  const seconds = [];
  page.on('request', (request) => {
    if (request.url().endsWith('/later.js')) seconds.push(request.url());
  });
  let letGo;
  const held = new Promise((resolve) => {
    letGo = resolve;
  });
  // Without a state, there is no first screen.
  await page.routeWebSocket('**/api/v1/ws', (socket) => {
    const server = socket.connectToServer();
    server.onMessage(async (message) => {
      await held;
      socket.send(message);
    });
  });
  let before = null;
  await page.route('**/app.js', async (route) => {
    // By then, the script before it has run.
    await page.waitForFunction(() => document.documentElement.dataset.theme);
    before = seconds.length;
    await route.continue();
  });
  const second = page.waitForRequest('**/later.js');
  await page.goto(served.url);
  await second;
  assert.equal(before, 0);
  assert.equal(await page.locator('.figure-main').count(), 0);
  letGo();
  await page.waitForSelector('.motion-panel');
  assert.equal(seconds.length, 1);
  assertClean(visitor);
});

test('the controls do not wait for the library of the charts', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/readyz', hasOwnTimes: true });
  const { page } = visitor;
  let letGo;
  const held = new Promise((resolve) => {
    letGo = resolve;
  });
  await page.route('**/plots.js', async (route) => {
    await held;
    await route.continue();
  });
  await page.goto(served.url);
  await homed(page);
  await page.waitForSelector('.charts-panel');
  await rendered(page);
  const before = await places(page);
  assert.equal(await page.locator('.charts-panel canvas').count(), 0);
  letGo();
  await page.waitForSelector('.charts-panel canvas');
  assert.deepEqual(await places(page), before);
  // The curves of another view wait for the same script.
  await page.click('[data-view=history]');
  await page.click('tbody button');
  await page.waitForSelector('.curve-place canvas');
  assertClean(visitor);
});

test('the times that other tests lengthen exist in the page', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { path: '/readyz', hasOwnTimes: true });
  const scripts = [];
  page.on('response', async (response) => {
    if (response.request().resourceType() === 'script') scripts.push(await response.text().catch(() => ''));
  });
  await page.goto(served.url);
  await until('the page has all of these times', () =>
    LONGER_TIMES.every(([own]) => scripts.some((text) => text.includes(own))),
  );
});

test('a widget is shown alone, in a frame of a configured page', async () => {
  let framed = '';
  const other = createServer((_asked, answer) => {
    answer.writeHead(200, { 'content-type': 'text/html' });
    answer.end(`<iframe src="${framed}"></iframe>`);
  });
  await new Promise((resolve) => {
    other.listen(0, '127.0.0.1', resolve);
  });
  started.push(() => other.close());
  const served = await gateway();
  const alone = await visit(launched, served, { path: '/?view=jaws#/right' });
  await alone.page.waitForSelector('.widget .jaws-panel');
  assert.equal(await alone.page.locator('#stop, .navigation, #take-control').count(), 0);
  await alone.page.keyboard.press('Escape');
  await alone.page.waitForSelector('.stopped:has-text("FAST STOP confirmed")');
  await alone.page.goto(`${served.url}/?view=alarms`);
  await alone.page.waitForSelector('.widget .alarms-panel');
  assertClean(alone);
  await alone.close();
  const url = `http://127.0.0.1:${other.address().port}`;
  const allowing = await gateway({ toml: `frame_ancestors = ["${url}"]\n` });
  framed = `${allowing.url}/?view=jaws#/right`;
  const shown = await visit(launched, { url });
  await shown.page.frameLocator('iframe').locator('.jaws-panel').waitFor();
  await shown.close();
  framed = `${served.url}/?view=jaws#/right`;
  const refused = await visit(launched, { url });
  await until('the browser refuses the frame', () => refused.wrong.some((text) => text.includes('frame-ancestors')));
});
