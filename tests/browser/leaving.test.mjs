// A page that is loaded again keeps control; one that is left, frozen or put away is a lost client. A wrong clock of the
// panel changes no age.

import assert from 'node:assert/strict';
import { after, test } from 'node:test';

import {
  altered,
  assertClean,
  browser,
  CHROMIUM,
  controlled,
  gateway,
  homed,
  launch,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

/** A browser that keeps pages for Back, which automated browsers do not by default, and the headless shell never does. */
const keeping = await launch({ executablePath: CHROMIUM, ignoreDefaultArgs: ['--disable-back-forward-cache'] });
after(() => keeping.close());

const state = (served) => served.ask('GET', 'grippers/left/state');
const leaseEvents = async (served) => (await served.ask('GET', 'events?kind=lease&order=oldest')).events;

/** Lets a page that is left wait longer for its last requests: a busy machine passes them on late. */
const LATE_LAST_REQUESTS = ['SENT_WITHIN_MS = 300;', 'SENT_WITHIN_MS = 3000;'];

/** Keeps back requests for a time. */
const delayed = (page, address, ms) =>
  page.route(address, async (route) => {
    await new Promise((resolve) => {
      setTimeout(resolve, ms);
    });
    await route.continue();
  });

test('a reload keeps control of a held part, without an alarm', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await altered(page, LATE_LAST_REQUESTS);
  // The request that keeps control needs longer than the page.
  await delayed(page, '**/grippers/left/lease', 500);
  await homed(page);
  await page.click('#grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  await page.waitForSelector('#release:enabled');
  for (let reloads = 0; reloads < 2; reloads += 1) {
    await page.reload();
    await page.waitForSelector('.status.tone-mine');
  }
  assert.deepEqual((await served.ask('GET', 'alarms')).alarms, []);
  assert.deepEqual(
    (await leaseEvents(served)).filter(({ event }) => event === 'lost'),
    [],
  );
  await page.click('#release:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Release")');
  assertClean(visitor);
});

test('a reload that the gateway answers late keeps control', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await altered(page, LATE_LAST_REQUESTS);
  await controlled(page);
  // Longer than the time after which the page keeps control again.
  await delayed(page, `${served.url}/`, 3000);
  await page.reload();
  await page.waitForSelector('.status.tone-mine');
  assert.deepEqual(
    (await leaseEvents(served)).map(({ event }) => event),
    ['taken'],
  );
  assertClean(visitor);
});

test('what is reserved for this person says so, and is taken back by one touch', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const first = await visit(launched, served, { name: 'Anna' });
  await homed(first.page);
  await first.page.click('#grip:enabled');
  await first.page.waitForSelector('.result[data-result=HOLDING]');
  await first.close();
  const { page } = await visit(launched, served, { name: 'Anna' });
  await page.waitForSelector('[data-notice=reserved]:has-text("reserved for you")');
  await page.waitForSelector('.take:has-text("Reserved for you.")');
  await page.click('#take-control:has-text("Take back")');
  await page.waitForSelector('.status.tone-mine');
});

/** Takes control, and enters a slow motion. */
async function aboutToMove(page) {
  await homed(page);
  await page.fill('#width', '1');
  await page.fill('#speed', '5');
  await page.waitForSelector('#move:enabled');
}

/** Takes control, and starts a slow motion. */
async function moving(page, served) {
  await aboutToMove(page);
  await page.click('#move:enabled');
  await until('the fingers move', async () => (await state(served)).moving);
}

test('a motion that was requested right before the page is left is stopped', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await aboutToMove(page);
  await page.evaluate(() => {
    document.querySelector('#move').click();
    location.href = '/docs/guide';
  });
  await page.waitForURL('**/docs/guide**', { waitUntil: 'commit' });
  const left = Date.now();
  await until('the gripper is stopped', async () => (await state(served)).fast_stop_cause === 'client_lost');
  assert.ok(Date.now() - left < 5000, `${Date.now() - left} ms`);
});

test('following a link while the fingers move is the loss of the client, and Back connects anew', async () => {
  const served = await gateway();
  const { page } = await visit(keeping, served);
  await moving(page, served);
  await page.evaluate(() => {
    globalThis.isSamePage = true;
    location.href = '/docs/guide';
  });
  await page.waitForURL('**/docs/guide**', { waitUntil: 'commit' });
  const left = Date.now();
  const stopped = await until('the gripper is stopped', async () => {
    const now = await state(served);
    return now.fast_stop ? now : null;
  });
  assert.equal(stopped.fast_stop_cause, 'client_lost');
  assert.ok(Date.now() - left < 5000, `${Date.now() - left} ms`);
  // A page that still loads cannot go back.
  await page.waitForLoadState();
  await page.goBack({ waitUntil: 'commit' });
  await page.waitForSelector('.latch:has-text("was lost while the fingers moved")');
  assert.equal(await page.evaluate(() => globalThis.isSamePage), true, 'the browser kept the page');
  await page.waitForFunction(() => !document.querySelector('.cover'));
});

test('a frozen tab does not hold control', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await controlled(page);
  // A browser freezes only hidden tabs, and automated ones are always visible: the page gets the browser's events.
  await page.evaluate(() => document.dispatchEvent(new Event('freeze')));
  await until('the lease is free', async () => (await state(served)).lease_holder === null);
  await page.evaluate(() => document.dispatchEvent(new Event('resume')));
  await page.waitForSelector('[data-notice=lost]');
  await page.waitForSelector('#take-control:enabled');
});

test('a wrong clock of the panel changes no age', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { hasOwnTimes: true });
  await page.clock.install({ time: Date.now() - 2 * 3600_000 });
  await page.reload();
  await page.waitForSelector('#take-control');
  await served.ask('POST', 'grippers/left/fast-stop');
  await page.waitForSelector('.latch dd:text-matches("\\\\(\\\\d+ s ago\\\\)")');
});
