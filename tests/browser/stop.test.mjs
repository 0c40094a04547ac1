// STOP: from every view, over every connection, and its displayed result.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  altered,
  appears,
  assertClean,
  browser,
  gateway,
  LONGER_TIMES,
  named,
  rendered,
  simulator,
  slowReads,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

test('STOP works by key from any view and from a field, and without the WebSocket', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  const latch = async () => (await served.ask('GET', 'grippers/left/state')).fast_stop_id;
  let last = null;
  const stopsBy = async (how, act) => {
    await act();
    last = await until(how, async () => {
      const now = await latch();
      return now && now !== last ? now : null;
    });
  };
  for (const view of ['operate', 'history', 'log', 'device', 'all']) {
    await page.click(`[data-view=${view}]`);
    await stopsBy(`Escape in ${view}`, () => page.keyboard.press('Escape'));
  }
  await page.click('[data-view=log]');
  await page.focus('#editor-payload');
  await stopsBy('Escape in a field', () => page.keyboard.press('Escape'));
  await stopsBy('Pause', () => page.keyboard.press('Pause'));

  // Without a WebSocket, STOP uses a request.
  const without = await visit(launched, served);
  without.allowed.connections = true;
  await without.page.routeWebSocket('**/api/v1/ws', (socket) => socket.close());
  await without.page.reload();
  await without.page.waitForSelector('#stop');
  await named(without.page, 'Zoë');
  await stopsBy('STOP without a WebSocket', () => without.page.click('#stop'));
  await without.page.waitForSelector('.stopped:has-text("confirmed")');
  const { door, label } = await until('the FAST STOP is recorded', async () => {
    const { events } = await served.ask('GET', 'events?kind=fast_stop');
    return events.find(({ event, fast_stop_id: id }) => event === 'latched' && id === last);
  });
  assert.deepEqual([door, label], ['http', 'Zoë']);

  // On a WebSocket that drops a FAST STOP, the request follows after 300 ms, or later on a busy machine.
  const silent = await visit(launched, served, { hasOwnTimes: true });
  await silent.page.routeWebSocket('**/api/v1/ws', (socket) => {
    const server = socket.connectToServer();
    socket.onMessage((message) => {
      if (!String(message).includes('fast-stop')) server.send(message);
    });
  });
  // Otherwise the request would follow once the page has given up waiting for the WebSocket.
  await altered(silent.page, ...LONGER_TIMES.filter(([own]) => own.startsWith('STOPS_WITHIN_MS')));
  await silent.page.waitForSelector('#take-control');
  const pressedAt = Date.now();
  await stopsBy('STOP on a WebSocket that swallows it', () => silent.page.click('#stop'));
  const ms = Date.now() - pressedAt;
  assert.ok(ms < 15_000, `${ms} ms`);
  assertClean(visitor);
  assertClean(silent);
});

test('STOP acts on touch, also with a second finger and a sliding one', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  // A late answer on the socket causes an extra request, so the test counts socket messages.
  await page.addInitScript(() => {
    globalThis.stopsSent = 0;
    const { send } = WebSocket.prototype;
    WebSocket.prototype.send = function counted(message) {
      if (String(message).includes('"fast-stop"')) globalThis.stopsSent += 1;
      return send.call(this, message);
    };
  });
  await page.reload();
  await page.waitForSelector('.status:has-text("connected")');
  const box = await page.locator('#stop').boundingBox();
  const touches = await page.context().newCDPSession(page);
  const touch = (type, points) => touches.send('Input.dispatchTouchEvent', { type, touchPoints: points });
  const other = { x: 20, y: box.y + 300, id: 0 };
  const finger = { x: box.x + 20, y: box.y + 20, id: 1 };
  await touch('touchStart', [other]);
  await touch('touchStart', [other, finger]);
  await touch('touchMove', [other, { ...finger, x: finger.x + 60 }]);
  await until('the gripper is stopped', async () => (await served.ask('GET', 'grippers/left/state')).fast_stop);
  await touch('touchEnd', []);
  await page.waitForSelector('#latch-title');
  assert.equal(await page.evaluate(() => globalThis.stopsSent), 1, 'one press is one FAST STOP');
});

test('STOP does not wait for pending reads', async () => {
  const served = await gateway();
  const slow = await slowReads(served);
  const visitor = await visit(launched, slow, { path: '/#/left/history' });
  const { page } = visitor;
  visitor.allowed.connections = true;
  await page.waitForSelector('#stop');
  // More requests than a browser opens connections to a host.
  await page.evaluate("for (let count = 1; count <= 8; count += 1) get('events?limit=' + count).catch(() => {});");
  await until('all connections are taken', () => slow.held() >= 6);
  await page.click('#stop');
  await page.waitForSelector('.stopped:has-text("confirmed")');
  assert.equal((await served.ask('GET', 'grippers/left/state')).fast_stop, true);
  assert.ok(slow.held() >= 6, 'no read was answered meanwhile');
});

test('a read cancelled by STOP is repeated', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  let reads = 0;
  await page.route('**/api/v1/events?*', (route) => {
    reads += 1;
    return reads === 1 ? undefined : route.continue();
  });
  await page.exposeFunction('reads', () => reads);
  // The page's own functions are global names there.
  const result = await page.evaluate(`(async () => {
    const read = get('events?limit=1').then(
      ({ events }) => events.length,
      (problem) => problem,
    );
    while ((await globalThis.reads()) === 0) await new Promise(requestAnimationFrame);
    const { fast_stop_id: id } = await postUrgently('grippers/left/fast-stop', { reason: 'a test' }, 5000);
    return { id, read: await read };
  })()`);
  assert.ok(result.id);
  assert.deepEqual([result.read, reads], [1, 2]);
});

test('the result of the newest STOP is shown', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { hasOwnTimes: true });
  const { page } = visitor;
  visitor.allowed.connections = true;
  await page.routeWebSocket('**/api/v1/ws', (socket) => socket.close());
  let presses = 0;
  await page.route('**/api/v1/fast-stop', async (route) => {
    presses += 1;
    // The first request gets no answer.
    if (presses > 1) await route.continue();
  });
  await page.reload();
  const ended = page.waitForEvent('requestfailed', (request) => request.url().endsWith('/fast-stop'));
  await page.click('#stop');
  await until('the first STOP is sent', () => presses === 1);
  await page.click('#stop');
  await page.waitForSelector('.stopped:has-text("confirmed")');
  await ended;
  await rendered(page);
  assert.equal(await page.locator('.stopped:has-text("did not get through")').count(), 0);
});

test('FAST STOP of one gripper shows whether it is confirmed, and that it failed', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`, '--gripper', 'right=sim://wsg50'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  visitor.allowed.connections = true;
  await page.waitForSelector('#take-control');
  device.child.kill('SIGSTOP');
  await page.waitForSelector('.cover');
  await page.click('#stop-one');
  await page.waitForSelector('.stopped:has-text("not yet confirmed by left")');
  await page.click('.chip:has-text("right")');
  await page.click('#stop-one:has-text("right")');
  // Results that are not as wanted come first; the others are in the list.
  const unconfirmed = page.locator('.strip > .stopped:has-text("not yet confirmed by left")');
  assert.equal(await unconfirmed.count(), 1);
  const results = page.locator('.strip-list .stopped');
  await page.click('#notices-more');
  await results.filter({ hasText: 'FAST STOP confirmed (right).' }).waitFor();

  // The result for all grippers includes each of them, until one has its own.
  await page.keyboard.press('Escape');
  await until('one result is left', async () => (await results.count()) === 1);
  await page.click('#notices-more');
  await unconfirmed.waitFor();
  device.child.kill('SIGCONT');
  await page.waitForSelector('.stopped:has-text("FAST STOP confirmed (this gateway: 2).")');
  await page.click('.chip:has-text("left")');
  await until('left has confirmed', async () => {
    await page.click('#stop-one:has-text("left")');
    return appears(page, '.stopped:has-text("FAST STOP confirmed (left).")', 5000);
  });
  await unconfirmed.waitFor({ state: 'detached' });

  await page.click('.chip:has-text("right")');
  await served.kill();
  await page.waitForSelector('.alarm:has-text("No connection to the gateway")');
  await page.click('#stop-one');
  await page.waitForSelector('.stopped:has-text("right: FAST STOP did not get through")');
  await page.keyboard.press('Escape');
  await page.waitForSelector('.stopped p:text-matches("^FAST STOP did not get through")');
});
