// Features that an operator relies on: the reach of STOP, results of grips, notices, and the width to open to.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { misfits, violations } from './checks.mjs';
import {
  assertClean,
  browser,
  confirmed,
  controlled,
  gateway,
  homed,
  named,
  shoot,
  stopped,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

const text = (page, selector) => page.locator(selector).first().innerText();
const state = (served, gripper = 'left') => served.ask('GET', `grippers/${gripper}/state`);

test('STOP shows its reach, and the fleet has its own STOP', async () => {
  const near = await gateway({ more: ['--name', 'cell-1', '--gripper', 'left=sim://wsg50'] });
  const visitor = await visit(launched, near, { path: '/#/left/all' });
  const { page } = visitor;
  const endpoint = await near.says(/Zenoh: (tcp\/127\.0\.0\.1:\d+)/);
  const far = await gateway({
    toml: 'public_url = "https://cell-2.example/"\n',
    more: ['--name', 'cell-2', '--zenoh-connect', endpoint, '--gripper', 'right=sim://wsg50'],
  });
  await page.waitForSelector('tbody tr:has-text("cell-2")');
  assert.equal(await page.getAttribute('tbody tr a:has-text("cell-2")', 'href'), 'https://cell-2.example/');
  assert.match(await text(page, '#stop'), /this gateway: 1/);
  await page.click('#stop');
  await page.waitForSelector('.stopped:has-text("confirmed (this gateway: 1).")');
  assert.match(await text(page, '.stopped'), /other gateways were not stopped/);
  assert.equal((await state(far, 'right')).fast_stop, false);
  assert.match(await text(page, '#stop-fleet'), /all gateways: 2 grippers/);
  await page.click('#stop-fleet');
  await until('the far gripper is stopped', async () => (await state(far, 'right')).fast_stop);
  await confirmed(page, '#stop-fleet', '.stopped:has-text("confirmed (all gateways: 2 grippers).")');
  await shoot(page, 'fleet-stopped');
  assert.deepEqual([...(await violations(page)), ...(await misfits(page))], []);
  assertClean(visitor);
});

test('Release opens to a width of its own, which the browser remembers', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.fill('#width', '20');
  assert.equal(await page.inputValue('#open'), '30');
  await page.click('#grip:enabled');
  await page.waitForSelector('[data-outcome=PART_HELD]');
  await page.click('#release:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Release")');
  await until('the fingers are open', async () => Math.abs((await state(served)).width_mm - 30) < 0.1);
  // Never wider than the stroke, and never empty.
  await page.fill('#width', '105');
  assert.equal(await page.inputValue('#open'), '110');
  await page.fill('#open', '');
  await page.waitForSelector('#open-hint:has-text("empty: 110 mm")');
  await page.fill('#open', '55');
  await page.fill('#width', '40');
  await page.waitForSelector('#grip:has-text("40 mm")');
  await page.waitForSelector('#release:has-text("55 mm")');
  await page.reload();
  await page.waitForSelector('#open');
  assert.equal(await page.inputValue('#open'), '55');
  assertClean(visitor);
});

test('a grip’s result is large beside the jaws', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.click('#grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]:has-text("Part held")');
  await page.locator('.figure-main .figure-value', { hasText: /19\.\d\d/ }).waitFor();
  await page.locator('.figure-force .figure-value', { hasText: /\d+\.\d/ }).waitFor();
  for (const [large, least] of [
    ['.result', 26],
    ['.figure-main .figure-value', 40],
    ['.figure-force .figure-value', 30],
  ]) {
    const size = await page.locator(large).evaluate((one) => Number.parseFloat(getComputedStyle(one).fontSize));
    assert.ok(size >= least, `${large}: ${size}`);
  }
  // A value stands once.
  assert.doesNotMatch(await text(page, '.result'), /mm/);
  assert.equal(await page.locator('.jaws .dimension text').count(), 0);
  await page.click('#release:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Release")');
  await page.waitForFunction(() => !document.querySelector('.result'));
  // At this width, the fingers find nothing to grip.
  await page.fill('#width', '5');
  await page.fill('#open', '80');
  await page.click('#release:enabled');
  await page.waitForSelector('#grip:enabled');
  await shoot(page, 'result');
  assertClean(visitor);
});

test('a failed grip has no tick, and says where the fingers stopped', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=0'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.click('#grip:enabled');
  await page.waitForSelector('.result.tone-high[data-result=NO_PART]:has-text("No part")');
  await page.waitForSelector('.last[data-outcome=NO_PART] .shape-high');
  assert.equal(await page.locator('.last .shape-check').count(), 0);
  await shoot(page, 'no-part');
  await page.fill('#open', '100');
  await page.click('#release:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Release")');
  await page.fill('#speed', '10');
  await page.click('#grip:enabled');
  await until('the fingers move', async () => (await state(served)).width_mm < 99);
  await page.click('#stop-soft');
  await page.waitForSelector('.result[data-result=ABORTED]:has-text("stopped at")');
  const { width_mm } = await state(served);
  const [, shown] = /Grip: aborted\s+stopped at (\d+\.\d+) mm/.exec(await text(page, '.result'));
  // The fingers still move a little after the command has ended.
  assert.ok(Math.abs(Number(shown) - width_mm) < 1, `${shown} is not ${width_mm}`);
  assertClean(visitor);
});

test('an error that lasts until the next motion is explained', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await stopped(page);
  await page.click('#acknowledge:enabled');
  await page.waitForSelector('.result[data-result=ERROR]:has-text("Error until the next motion")');
  await page.waitForSelector('.result:has-text("the gripper accepts motions")');
  // The bar is calm too: nothing is left to do.
  await page.waitForSelector('.status:not([class*=tone]):has-text("Acknow")');
  await page.click('#home:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]');
  await page.waitForFunction(() => !document.querySelector('.result'));
  assertClean(visitor);
});

test('notices are shown in every view', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await named(anna.page, 'Anna');
  await named(ben.page, 'Ben');
  await controlled(anna.page);
  await ben.page.click('.take button:has-text("Ask for control")');
  for (const view of ['history', 'log', 'device', 'all', 'operate']) {
    await anna.page.click(`[data-view=${view}]`);
    await anna.page.waitForSelector('[data-notice=asked]:has-text("Ben is asking for control of left")');
  }
  await shoot(anna.page, 'notice-asked');
  await anna.page.click('.strip:not([data-fresh]) [data-notice=asked] [aria-label^="Not now"]');
  await anna.page.waitForFunction(() => !document.querySelector('[data-notice=asked]'));
  assert.ok(await anna.page.locator('.take [aria-label^="Hand over to Ben"]').isVisible());

  await anna.page.click('[data-view=history]');
  await ben.page.click('#force-control');
  await ben.page.click('#force-control-sure');
  await ben.page.waitForSelector('.status.tone-mine');
  await anna.page.waitForSelector('[data-notice=lost]:has-text("Ben took control of left from you by force")');
  await anna.page.waitForSelector('.strip[data-fresh]', { state: 'detached' });
  await anna.page.click('[data-notice=lost] .notice-close');
  await anna.page.waitForFunction(() => !document.querySelector('[data-notice=lost]'));

  // A refusal follows the user to another view.
  await ben.page.evaluate("ask(find('left'), 'grip', { width_mm: 20, speed_mm_s: 50 })");
  await ben.page.click('[data-view=history]');
  await ben.page.waitForSelector('[data-notice=problem]:has-text("not referenced")');
  await ben.page.waitForSelector('.strip[data-fresh]', { state: 'detached' });
  await ben.page.click('[data-notice=problem] .notice-close');
  await ben.page.waitForFunction(() => !document.querySelector('[data-notice=problem]'));
  [anna, ben].forEach(assertClean);
});

test('a tap on a notice that has just appeared does nothing', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  /** Taps a button as soon as it is there, or a while later. */
  const tapWhenShown = (selector, waitMs) =>
    page.evaluate(
      ([wanted, wait]) => {
        window.tapped = new Promise((resolve) => {
          const look = () => {
            const button = document.querySelector(wanted);
            if (!button) {
              requestAnimationFrame(look);
              return;
            }
            setTimeout(() => {
              const { left, top } = button.getBoundingClientRect();
              const more = { detail: 1, bubbles: true, cancelable: true, clientX: left + 5, clientY: top + 5 };
              resolve(button.dispatchEvent(new MouseEvent('click', more)));
            }, wait);
          };
          look();
        });
      },
      [selector, waitMs],
    );
  await tapWhenShown('#hand-over', 0);
  await served.ask('POST', 'grippers/left/lease', { holder: 'Ben', request: true });
  assert.equal(await page.evaluate('tapped'), false, 'the tap is dropped');
  assert.equal((await served.ask('GET', 'grippers/left/state')).lease_holder, await page.inputValue('#my-name'));
  await tapWhenShown('#hand-over', 700);
  assert.equal(await page.evaluate('tapped'), true);
  await until('Ben has control', async () => (await served.ask('GET', 'grippers/left/state')).lease_holder === 'Ben');
  assertClean(visitor);
});

test('the second click of a double click presses nothing else', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  let takes = 0;
  anna.page.on('websocket', (socket) =>
    socket.on('framesent', ({ payload }) => {
      if (String(payload).includes('"lease.take"')) takes += 1;
    }),
  );
  await anna.page.reload();
  await anna.page.waitForSelector('#take-control');
  await anna.page.dblclick('#take-control');
  await anna.page.waitForSelector('.status.tone-mine');
  // The button to give up control is at the same place.
  await anna.page.waitForSelector('html:not([data-pressed])');
  assert.ok(await anna.page.isVisible('.status.tone-mine'));
  assert.equal(takes, 1);
  await ben.page.waitForSelector('#force-control');
  await ben.page.dblclick('#force-control');
  await ben.page.waitForSelector('#force-control-sure');
  assert.ok(await anna.page.isVisible('.status.tone-mine'), 'force asks for confirmation');
  [anna, ben].forEach(assertClean);
});

test('a reserved gripper is never shown as free, and its lost holder is an alarm', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  const { page } = ben;
  await named(anna.page, 'Anna');
  await homed(anna.page);
  await anna.page.click('#grip:enabled');
  await anna.page.waitForSelector('[data-outcome=PART_HELD]');
  await anna.close();
  await page.waitForSelector('.alarm:has-text("left: client lost while a part is held")');
  await page.waitForSelector('[data-notice=reserved]:has-text("left is reserved for Anna")');
  await page.waitForSelector('.status:has-text("reserved: Anna")');
  assert.doesNotMatch(await text(page, 'body'), /nobody/i);
  await shoot(page, 'reserved');
  await page.click('[data-view=all]');
  await page.waitForSelector('.tile:has-text("reserved: Anna")');
  await page.waitForSelector('.strip[data-fresh]', { state: 'detached' });
  await page.click('#notice-force-control');
  assert.equal((await served.ask('GET', 'grippers/left/lease')).held, false, 'force asks for confirmation');
  await page.click('#notice-force-control-sure');
  await page.waitForSelector('.status.tone-mine');
  await page.waitForFunction(() => !document.querySelector('[data-notice=reserved]'));
  await page.click('[data-view=operate]');
  await page.waitForSelector('.alarm:has-text("cleared")');
  assertClean(ben);
});
