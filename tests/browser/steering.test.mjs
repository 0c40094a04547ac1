// Steering by the slider: its rate, who steers, and what ends it.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { misfits, places, violations } from './checks.mjs';
import { assertClean, browser, controlled, gateway, homed, named, rendered, shoot, until, visit } from './harness.mjs';

const launched = await browser();

const RATE_HZ = 50;
const LEAST_SHARE = 0.9;

/** Other processes take time from the browser, so the best of several presses counts. */
const TRIES = 3;

const PHONE = { width: 390, height: 844, hasTouch: true, isMobile: true };

const session = (served) => served.ask('GET', 'grippers/left/servo');
const state = (served) => served.ask('GET', 'grippers/left/state');

const ended = (served) =>
  until('the session has ended', async () => {
    const known = await session(served);
    return known.open === false && known;
  });

const accepted = (served, least) =>
  until(`${least} targets are accepted`, async () => {
    const known = await session(served);
    return known.accepted >= least && known;
  });

/** Presses the slider at a share of its length, and returns a function that moves the pointer to another one. */
async function held(page, share) {
  await page.locator('#steer:enabled').scrollIntoViewIfNeeded();
  const { x, y, width, height } = await page.locator('#steer').boundingBox();
  const to = (at, steps = 1) => page.mouse.move(x + at * width, y + height / 2, { steps });
  await to(share);
  await page.mouse.down();
  return to;
}

/** Methods of the requests that the page sends, from its next load on. */
function sentBy(page) {
  const methods = [];
  page.on('websocket', (socket) =>
    socket.on('framesent', ({ payload }) => methods.push(JSON.parse(String(payload)).method)),
  );
  return methods;
}

test('a held slider steers at 50 Hz, and its release ends the session', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { name: 'Anna' });
  const { page } = visitor;
  await homed(page);
  // On a busy machine, timers of a page are late. This one shows by how much.
  await page.evaluate((everyMs) => {
    globalThis.ticks = 0;
    setInterval(() => {
      globalThis.ticks += 1;
    }, everyMs);
  }, 1000 / RATE_HZ);
  const ticks = () => page.evaluate(() => ({ count: globalThis.ticks, at: performance.now() }));
  let share = 0;
  for (let tries = 0; tries < TRIES && share < LEAST_SHARE; tries += 1) {
    const begin = await ticks();
    const to = await held(page, 0.8);
    await page.waitForSelector('.steered:has-text("You steer")');
    for (const place of [0.7, 0.6, 0.5, 0.6, 0.7]) {
      const before = await session(served);
      await to(place, 5);
      await accepted(served, before.accepted + 20);
    }
    const shown = Number(await page.inputValue('#steer'));
    await until('the newest target is that of the slider', async () => (await session(served)).target_mm === shown);
    await page.mouse.up();
    const { ended: why, refused } = await ended(served);
    assert.deepEqual([why, refused], ['ended', 0]);
    const { events } = await until('the end is recorded', async () => {
      const known = await served.ask('GET', 'events?kind=device');
      return known.events[0].event === 'servo_ended' && known;
    });
    const end = await ticks();
    const possible = Math.min(RATE_HZ, ((end.count - begin.count) * 1000) / (end.at - begin.at));
    const rate = (events[0].accepted * 1000) / events[0].duration_ms;
    console.log(`${rate.toFixed(1)} targets a second, ${possible.toFixed(1)} possible`);
    assert.ok(rate < RATE_HZ / LEAST_SHARE, `${rate} targets a second`);
    share = rate / possible;
  }
  assert.ok(share >= LEAST_SHARE, `${share} of the possible rate`);
  await until('the fingers stand', async () => !(await state(served)).moving);
  await page.waitForSelector('.steered', { state: 'detached' });
  await page.waitForSelector('#grip:enabled');
  await page.click('[data-view=history]');
  await page.click('[data-choice=records-events]');
  await page.waitForSelector('tr:has-text("a client steers the fingers (motions)"):has-text("Anna (127.0.0.1)")');
  await page.waitForSelector('tr:has-text("steering has ended (the client ended it)")');
  assertClean(visitor);
});

for (const [size, shape] of Object.entries({ phone: PHONE, desk: { width: 1366, height: 900 } })) {
  test(`steering is shown without moving a control, ${size}`, async () => {
    const served = await gateway();
    const visitor = await visit(launched, served, { ...shape, name: 'Anna' });
    const { page } = visitor;
    const other = await visit(launched, served, { ...shape, locale: 'de-DE' });
    await homed(page);
    await other.page.waitForSelector('#ask-control');
    await page.locator('#steer').scrollIntoViewIfNeeded();
    await rendered(page);
    const [before, before2] = [await places(page), await places(other.page)];
    const to = await held(page, 0.9);
    await to(0.5, 5);
    await page.waitForSelector('.steered:has-text("motions · ")');
    await page.waitForSelector('.result-note:text-matches("[1-9]\\\\d* Hz")');
    await other.page.waitForSelector('.steered:has-text("Anna lenkt")');
    await page.waitForSelector('.why:has-text("The fingers are being steered. Stop ends it.")');
    await page.waitForSelector('[data-notice=next]:has-text("The fingers are being steered.")');
    assert.deepEqual(
      await page
        .locator('#grip, #release, #home, #jog-open, #move')
        .evaluateAll((all) => all.filter((one) => !one.disabled).map(({ id }) => id)),
      [],
    );
    assert.ok(await page.locator('#stop-soft').isEnabled());
    for (const [where, known] of [
      [page, before],
      [other.page, before2],
    ]) {
      const now = await places(where);
      const moved = Object.keys(known).filter((key) => key in now && known[key] !== now[key] && key !== 'steer');
      assert.deepEqual(moved, []);
      assert.ok(Object.keys(known).length > 10);
    }
    await shoot(page, `steering-${size}`, { fullPage: true });
    await shoot(other.page, `steering-${size}-other`, { fullPage: true });
    for (const where of [page, other.page]) {
      assert.deepEqual(await violations(where), []);
      assert.deepEqual(await misfits(where), []);
    }
    await page.mouse.up();
    await ended(served);
    await other.page.waitForSelector('.steered', { state: 'detached' });
    [visitor, other].forEach(assertClean);
  });
}

test('no target follows STOP', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const methods = sentBy(page);
  await page.reload();
  await homed(page);
  const to = await held(page, 0.9);
  await to(0.2);
  await accepted(served, 20);
  await page.keyboard.press('Escape');
  const { ended: why, accepted: count } = await ended(served);
  assert.equal(why, 'fast_stop');
  await page.waitForSelector('#acknowledge:enabled');
  // The pointer is still down.
  await to(0.5, 10);
  await page.waitForSelector('.stopped:has-text("confirmed")');
  const after = methods.slice(methods.indexOf('fast-stop'));
  assert.ok(methods.indexOf('fast-stop') > 20);
  assert.deepEqual(
    after.filter((method) => method?.startsWith('servo.')),
    [],
  );
  assert.equal((await session(served)).accepted, count);
  assert.deepEqual((await served.ask('GET', 'events?kind=refused')).events, []);
  await page.mouse.up();
  assertClean(visitor);
});

test('a Stop of anybody ends steering, until the slider is pressed again', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const methods = sentBy(page);
  await page.reload();
  await homed(page);
  const to = await held(page, 0.9);
  await to(0.2);
  await accepted(served, 20);
  await served.ask('POST', 'grippers/left/stop');
  assert.equal((await ended(served)).ended, 'stop');
  await page.waitForSelector('[data-notice=problem]:has-text("Steering has ended. Hold the slider again.")');
  const sent = methods.length;
  await to(0.6, 10);
  await until('the page has asked for the state again', () => methods.slice(sent).includes('state'));
  assert.deepEqual(
    methods.slice(sent).filter((method) => method?.startsWith('servo.t')),
    [],
  );
  assert.equal((await session(served)).open, false);
  await page.mouse.up();
  await held(page, 0.9);
  await until('the next press steers', async () => (await session(served)).open);
  await page.mouse.up();
  assert.equal((await ended(served)).ended, 'ended');
  assertClean(visitor);
});

test('a page that hangs is silent, which stops the fingers', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { hasOwnTimes: true });
  await homed(page);
  // A busy machine can be silent by itself before the page hangs.
  await until('the session ends by silence while the page hangs', async () => {
    const to = await held(page, 0.9);
    await to(0.1);
    await accepted(served, 1);
    const hangs = page.evaluate(() => {
      const end = performance.now() + 1500;
      while (performance.now() < end);
    });
    const { ended: why } = await ended(served);
    const { moving } = await until('the fingers stand', async () => {
      const known = await state(served);
      return known.moving === false && known;
    });
    await hangs;
    await page.mouse.up();
    return why === 'silence' && moving === false;
  });
  assert.equal((await state(served)).fast_stop, false);
});

test('a page that is left while it steers is a lost client', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await homed(page);
  const to = await held(page, 0.9);
  await to(0.1);
  await accepted(served, 10);
  await page.evaluate(() => {
    location.href = '/docs/guide';
  });
  const { accepted: count } = await ended(served);
  await until('the gripper is stopped', async () => (await state(served)).fast_stop_cause === 'client_lost');
  assert.equal((await session(served)).accepted, count);
});

for (const [what, happens] of Object.entries({
  'another window is used': () => dispatchEvent(new Event('blur')),
  'the page is hidden': () => {
    Object.defineProperty(document, 'hidden', { value: true });
    document.dispatchEvent(new Event('visibilitychange'));
  },
  'the finger scrolls': () =>
    document.querySelector('#steer').dispatchEvent(new PointerEvent('pointercancel', { bubbles: true })),
})) {
  test(`steering ends when ${what}`, async () => {
    const served = await gateway();
    const { page } = await visit(launched, served);
    await homed(page);
    const to = await held(page, 0.9);
    await to(0.2);
    await accepted(served, 5);
    await page.evaluate(happens);
    assert.equal((await ended(served)).ended, 'ended');
    assert.equal((await state(served)).fast_stop, false);
  });
}

test('a lost connection ends steering', async () => {
  const served = await gateway();
  const { page, allowed } = await visit(launched, served);
  await homed(page);
  const to = await held(page, 0.9);
  await to(0.2);
  await accepted(served, 5);
  allowed.connections = true;
  await page.evaluate('rpc.renew()');
  const { accepted: count } = await ended(served);
  await page.waitForSelector('#acknowledge:enabled');
  assert.equal((await session(served)).accepted, count);
});

test('a second person asks for control, and gets it from the one who steers', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served, { name: 'Anna' }), await visit(launched, served, { name: 'Ben' })];
  await homed(anna.page);
  const to = await held(anna.page, 0.9);
  await to(0.3, 5);
  await ben.page.waitForSelector('.steered:has-text("Anna steers")');
  assert.ok(await ben.page.locator('#steer').isDisabled());
  await ben.page.waitForSelector('.why:has-text("Take control to move the fingers.")');
  await ben.page.click('#ask-control');
  await anna.page.waitForSelector('[data-notice=asked]:has-text("Ben is asking for control")');
  const asked = await session(served);
  assert.ok((await accepted(served, asked.accepted + 20)).open, 'the request stops nothing');
  await anna.page.waitForSelector('.strip:not([data-fresh]) #hand-over');
  // The pointer is on the slider: the keyboard hands over.
  await anna.page.evaluate(() => document.querySelector('#hand-over').click());
  await ben.page.waitForSelector('.status.tone-mine');
  const { ended: why, accepted: count } = await ended(served);
  assert.equal(why, 'lease');
  await anna.page.waitForSelector('#steer:disabled');
  await to(0.6, 10);
  await held(ben.page, 0.5);
  await until('Ben steers', async () => (await session(served)).open);
  await anna.page.waitForSelector('.steered:has-text("Ben steers")');
  await ben.page.mouse.up();
  await ended(served);
  const { events } = await served.ask('GET', 'events?kind=device');
  const counts = events.filter(({ event }) => event === 'servo_ended').map((event) => event.accepted);
  assert.equal(counts.at(-1), count, 'no target of Anna follows');
  [anna, ben].forEach(assertClean);
});

test('the slider steers by keys while they are held, and says why it is off', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#steer:disabled');
  await page.waitForSelector('.why:has-text("Take control")');
  await controlled(page);
  await page.waitForSelector('.why:has-text("Home first")');
  assert.ok(await page.locator('#steer').isDisabled());
  await page.click('#home:enabled');
  await page.waitForSelector('#steer:enabled');
  await named(page, 'Anna');
  await page.focus('#steer');
  const from = (await state(served)).width_mm;
  await page.keyboard.down('PageDown');
  await until('the fingers move', async () => (await state(served)).width_mm < from - 1);
  await page.keyboard.up('PageDown');
  const { ended: why, target_mm: target } = await ended(served);
  assert.equal(why, 'ended');
  assert.ok(target < from - 5, `${target}`);
  // The slider shows the width again.
  await until('the slider is at the width', async () => {
    const { width_mm: width, moving } = await state(served);
    return moving === false && Math.abs(Number(await page.inputValue('#steer')) - width) < 0.5;
  });
  assertClean(visitor);
});
