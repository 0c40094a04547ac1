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
  await page.waitForSelector('.why:has-text("Grip and Move go to 40 mm, Release opens to 55 mm")');
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
  await page.locator('.result', { hasText: /19\.\d mm · \d+\.\d N/ }).waitFor();
  const size = await page.locator('.result').evaluate((one) => Number.parseFloat(getComputedStyle(one).fontSize));
  assert.ok(size >= 20, `${size}`);
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
  const [, shown] = /Grip: aborted\s+stopped at (\d+\.\d) mm/.exec(await text(page, '.result'));
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
  const asks = () => ben.page.click('.take button:has-text("Ask for control")');
  await asks();
  for (const view of ['history', 'log', 'device', 'all', 'operate']) {
    await anna.page.click(`[data-view=${view}]`);
    await anna.page.waitForSelector('[data-notice=asked]:has-text("Ben is asking for control of left")');
  }
  await shoot(anna.page, 'notice-asked');
  await anna.page.click('[data-notice=asked] button:has-text("Not now")');
  await anna.page.waitForFunction(() => !document.querySelector('[data-notice=asked]'));
  assert.ok(await anna.page.locator('.control-panel button:has-text("Hand over to Ben")').isVisible());

  await anna.page.click('[data-view=history]');
  await ben.page.click('#force-control');
  await ben.page.click('#force-sure');
  await ben.page.waitForSelector('.status.tone-mine');
  await anna.page.waitForSelector('[data-notice=lost]:has-text("Ben took control of left from you by force")');
  await anna.page.click('[data-notice=lost] button');
  await anna.page.waitForFunction(() => !document.querySelector('.notice'));

  // A refusal follows the user to another view.
  await ben.page.evaluate("ask(find('left'), 'grip', { width_mm: 20, speed_mm_s: 50 })");
  await ben.page.click('[data-view=history]');
  await ben.page.waitForSelector('[data-notice=problem]:has-text("not referenced")');
  await ben.page.click('[data-notice=problem] button');
  await ben.page.waitForFunction(() => !document.querySelector('.notice'));
  [anna, ben].forEach(assertClean);
});

test('a tap just after a notice has moved the page does not move the fingers', async () => {
  const served = await gateway();
  await served.ask('PUT', 'recipes/ring', { number: 3, width_mm: 20, speed_mm_s: 200, release_width_mm: 40 });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.waitForSelector('.recipe [data-act="command.grip"]:enabled');
  /** Lets Grip, here and of a recipe, be tapped as soon as a notice moves it, or a while later. */
  const tapOnMove = (waitMs) =>
    page.evaluate((wait) => {
      const grips = ['#grip', '.recipe [data-act="command.grip"]'].map((grip) => document.querySelector(grip));
      const { top } = grips[0].getBoundingClientRect();
      window.tapped = new Promise((resolve) => {
        const look = () => {
          if (grips[0].getBoundingClientRect().top === top) {
            requestAnimationFrame(look);
            return;
          }
          setTimeout(() => {
            const more = { detail: 1, bubbles: true, cancelable: true };
            const tap = (grip) => {
              grip.dispatchEvent(new PointerEvent('pointerdown', more));
              return grip.dispatchEvent(new MouseEvent('click', more));
            };
            resolve(grips.map(tap));
          }, wait);
        };
        look();
      });
    }, waitMs);
  await page.evaluate(() => scrollTo(0, 0));
  await tapOnMove(0);
  await served.ask('POST', 'grippers/left/lease', { holder: 'Ben', request: true });
  assert.deepEqual(await page.evaluate('tapped'), [false, false], 'the taps are dropped');
  await tapOnMove(400);
  await page.click('[data-notice=asked] button:has-text("Not now")');
  assert.equal((await page.evaluate('tapped'))[0], true);
  await page.waitForSelector('.last[data-outcome=PART_HELD]');
  const { events } = await served.ask('GET', 'events?kind=command');
  assert.equal(events.filter(({ command, phase }) => command === 'grip' && phase === 'admitted').length, 1);
  assertClean(visitor);
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
  await page.click('#notice-force-control');
  assert.equal((await served.ask('GET', 'grippers/left/lease')).held, false, 'force asks for confirmation');
  await page.click('#notice-force-sure');
  await page.waitForSelector('.status.tone-mine');
  await page.waitForFunction(() => !document.querySelector('.notice'));
  await page.click('[data-view=operate]');
  await page.waitForSelector('.alarm:has-text("cleared")');
  assertClean(ben);
});
