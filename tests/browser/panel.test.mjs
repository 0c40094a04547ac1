// The next step of a person at the panel, recipes as tiles, all grippers at a glance, and the usual ranges of the history.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  assertClean,
  browser,
  controlled,
  gateway,
  homed,
  simulator,
  stopped,
  textsOf,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

const state = (served, gripper = 'left') => served.ask('GET', `grippers/${gripper}/state`);

/** Ids of the primary buttons of the operating view, without those of the strip. */
const primaries = (page) =>
  page.evaluate(() =>
    [...document.querySelectorAll('main .primary')]
      .filter((one) => one.checkVisibility() && !one.disabled)
      .map(({ id }) => id),
  );

test('one next action is primary, and what would be refused is not ready', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  await device.happens({ place_part: { width_mm: 20 } });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const is = (wanted, sentence) =>
    until(`${wanted} is primary`, async () => {
      const [only, ...others] = await primaries(page);
      const said = await page.locator('[data-notice=next]').innerText();
      return only === wanted && others.length === 0 && said.includes(sentence);
    });
  await is('take-control', 'Take control');
  await controlled(page);
  await is('home', 'home first');
  assert.ok(await page.locator('#grip').isDisabled());
  await page.click('#home:enabled');
  await is('grip', 'Ready to grip');
  await page.click('#grip:enabled');
  await is('release', 'Release first');
  await page.waitForSelector('.result.held[data-result=HOLDING]');
  await device.happens('take_part');
  await page.waitForSelector('.result.lost[data-result=PART_LOST]');
  await is('release', 'Release first');
  // The gripper refuses another grip now, so it is not offered, and says why.
  assert.ok(await page.locator('#grip').isDisabled());
  await page.waitForSelector('.why:has-text("Release first: the last grip held no part.")');
  await page.click('#release:enabled');
  await is('grip', 'Ready to grip');
  await stopped(page);
  await page.waitForSelector('#acknowledge:enabled');
  await is('acknowledge', 'check the cause');
  assertClean(visitor);
});

test('a fresh operator grips the right part with two touches, in German', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  await served.ask('POST', 'grippers/left/home');
  await served.ask('PUT', 'recipes/A-1047', {
    number: 1,
    width_mm: 20,
    speed_mm_s: 200,
    force_n: 30,
    release_width_mm: 40,
  });
  await served.ask('PUT', 'recipes/B-7', { number: 2, width_mm: 50, speed_mm_s: 200 });
  const visitor = await visit(launched, served, { width: 1280, height: 800, locale: 'de-DE', hasTouch: true });
  const { page } = visitor;
  const tile = page.locator('.recipe:has-text("A-1047") .tile-grip');
  await tile.waitFor();
  const { y, height } = await tile.boundingBox();
  assert.ok(y + height < 800, 'above the fold');
  await page.tap('#take-control');
  await page.waitForSelector('.recipe:has-text("A-1047") .tile-grip:enabled');
  await tile.tap();
  await page.waitForSelector('.result.held');
  await page.waitForSelector('.recipe.chosen .tile-last:has-text("Teil gehalten")');
  await page.waitForSelector('#grip:has-text("A-1047")');
  await page.waitForSelector('#release.primary:has-text("40 mm")');
  // A page that is opened now knows the recipe of the held part.
  const other = await visit(launched, served, { locale: 'de-DE' });
  await other.page.waitForSelector('.recipe.chosen:has-text("A-1047")');
  await other.page.waitForSelector('#release:has-text("40 mm")');
  [visitor, other].forEach(assertClean);
});

test('a refusal is shown in the language of the page, without backticks', async () => {
  const de = await textsOf('de');
  const served = await gateway();
  const { page } = await visit(launched, served, { locale: 'de-DE' });
  await controlled(page);
  await page.evaluate("ask(find('left'), 'grip', { width_mm: 20, speed_mm_s: 50 })");
  await page.waitForSelector(`[data-notice=problem]:has-text("${de['problem.not_referenced']}")`);
  await page.evaluate("ask(find('left'), 'grip', { width_mm: 'wide', speed_mm_s: 50 })");
  await until('another refusal is shown', async () => {
    const text = await page.locator('[data-notice=problem]').innerText();
    return !text.includes(de['problem.not_referenced']) && !text.includes('`');
  });
});

test('all grippers are sorted by need, each with its next step and its FAST STOP', async () => {
  const more = ['a', 'b', 'c'].flatMap((name) => ['--gripper', `${name}=sim://wsg50?part_mm=20`]);
  const served = await gateway({ more });
  for (const name of ['a', 'b', 'c']) await served.ask('POST', `grippers/${name}/home`);
  const visitor = await visit(launched, served, { path: '/#/a/all' });
  const { page } = visitor;
  const names = () => page.locator('.tile-open').evaluateAll((all) => all.map((one) => one.dataset.gripper));
  await until('all are shown', async () => (await names()).join() === 'a,b,c');
  await served.ask('POST', 'grippers/c/grip', { width_mm: 20, speed_mm_s: 300, part_id: 'ring' });
  await page.waitForSelector('.tile:has([data-gripper=c]):has-text("ring")');
  await page.click('[aria-label="FAST STOP b"]');
  await until('b is stopped', async () => (await state(served, 'b')).fast_stop);
  assert.equal((await state(served, 'a')).fast_stop, false);
  await until('b is first', async () => (await names()).join() === 'b,a,c');
  await page.waitForSelector('.tile:has([data-gripper=b]):has-text("check the cause, then acknowledge")');
  await page.waitForSelector('.tile:has([data-gripper=b]) .tile-alarms:has-text("FAST STOP")');
  assertClean(visitor);
});

test('the history has usual ranges, who moved, and jogs as jogs', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { name: 'Anna' });
  const { page } = visitor;
  await homed(page);
  await page.fill('#speed', '5');
  await page.locator('#jog-close').hover();
  const from = (await state(served)).width_mm;
  await page.mouse.down();
  await until('the jog moves the fingers', async () => (await state(served)).width_mm < from - 1);
  await page.mouse.up();
  await until('the fingers stand', async () => (await state(served)).moving === false);
  await page.click('[data-view=history]');
  await page.waitForSelector(
    'tbody tr:not(.bad):has-text("Jog"):has-text("button released"):has-text("Anna (127.0.0.1)")',
  );
  for (const range of ['hour', 'shift', 'today']) {
    await page.click(`[data-choice=range-${range}]`);
    await page.waitForSelector(`[data-choice=range-${range}][aria-pressed=true]`);
    assert.match(await page.inputValue('#from'), /^\d{4}-\d\d-\d\dT\d\d:\d\d$/);
    await page.waitForSelector('tbody tr:has-text("Jog")');
  }
  await page.click('[data-choice=range-today]');
  assert.equal(await page.inputValue('#from'), '');
  // A year of five digits breaks nothing.
  await page.evaluate(() => {
    const field = document.querySelector('#from');
    field.value = '12026-11-29T10:00';
    field.dispatchEvent(new Event('change', { bubbles: true }));
  });
  await page.waitForSelector('[role=alert]:has-text("enter a year of four digits")');
  assertClean(visitor);
});
