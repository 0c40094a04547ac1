// The history: filters, all grippers, overlaid curves, numbers per part, events in words, and the printed report.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';

import { assertClean, browser, gateway, shoot, until, visit } from './harness.mjs';

const launched = await browser();

const post = (served, path, body) => served.ask('POST', `grippers/${path}`, body);

/** Starts a gateway, and makes grips of two parts and a motion of another gripper. */
async function worked() {
  const served = await gateway();
  await Promise.all(['left', 'right'].map((gripper) => post(served, `${gripper}/home`)));
  for (const part_id of ['lot-1', 'lot-1', 'lot-2']) {
    await post(served, 'left/grip', { width_mm: 20, speed_mm_s: 300, part_id });
    await post(served, 'left/release', { width_mm: 60, speed_mm_s: 300 });
  }
  await post(served, 'right/move', { width_mm: 50, speed_mm_s: 300 });
  return served;
}

const rows = (page, wanted) =>
  page.waitForFunction((count) => document.querySelectorAll('.split tbody tr').length === count, wanted);

test('records are filtered by time, and shown for all grippers', async () => {
  const served = await worked();
  const visitor = await visit(launched, served, { path: '/#/left/history', timezoneId: 'Asia/Kolkata' });
  const { page } = visitor;
  await rows(page, 7);
  await page.click('#of-all');
  await rows(page, 9);
  await page.waitForSelector('tbody tr:first-child:has-text("right"):has-text("Move")');
  // Local times, as the page shows them.
  const local = (ms) => new Date(Date.now() + 5.5 * 3600_000 + ms).toISOString().slice(0, 16);
  await page.fill('#from', local(3600_000));
  await page.press('#from', 'Tab');
  await page.waitForSelector('p:has-text("No records.")');
  await page.fill('#from', local(-3600_000));
  await page.press('#from', 'Tab');
  await rows(page, 9);
  await page.fill('#to', local(-60_000 * 30));
  await page.press('#to', 'Tab');
  await page.waitForSelector('p:has-text("No records.")');
  const [file] = await Promise.all([page.waitForEvent('download'), page.click('#export')]);
  assert.equal(file.suggestedFilename(), 'all-grips.csv');
  assert.match(await readFile(await file.path(), 'utf8'), /^\uFEFFseq,id,/);
  const [plain] = await Promise.all([page.waitForEvent('download'), page.click('#export-plain')]);
  assert.equal(plain.suggestedFilename(), 'all-grips-plain.csv');
  assert.match(await readFile(await plain.path(), 'utf8'), /^seq,id,/);
  assertClean(visitor);
});

test('a held part is listed, although no event follows its record', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await post(served, 'left/home');
  await post(served, 'left/grip', { width_mm: 20, speed_mm_s: 300, part_id: 'lot-1' });
  await page.waitForSelector('tbody tr:has-text("lot-1")');
  assertClean(visitor);
});

test('the history is current although other events follow each other closely', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await page.waitForSelector('.nothing');
  let isBusy = true;
  const busy = (async () => {
    for (let count = 0; isBusy; count += 1) {
      await served.ask('PUT', 'grippers/right/settings/acceleration', { acceleration_mm_s2: 500 + (count % 100) });
      await new Promise((resolve) => {
        setTimeout(resolve, 50);
      });
    }
  })();
  await post(served, 'left/home');
  await page.waitForSelector('tbody tr:has-text("Home")').finally(() => {
    isBusy = false;
  });
  await busy;
  assertClean(visitor);
});

test('parts are searched by the beginning of their ids', async () => {
  const served = await worked();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await rows(page, 7);
  await page.fill('#part-filter', 'lot-');
  await rows(page, 3);
  await page.fill('#part-filter', 'lot-2');
  await rows(page, 1);
  await page.click('[data-choice=records-events]');
  await page.waitForFunction(() => document.querySelectorAll('tbody tr').length === 2);
  await page.fill('#part-filter', 'ot-');
  await page.waitForSelector('p:has-text("No records.")');
  assertClean(visitor);
});

test('curves are laid over each other, with the values under one cursor', async () => {
  const served = await worked();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await rows(page, 7);
  const curve = (index) => page.click(`tbody tr:has-text("Grip") button >> nth=${index}`);
  await curve(0);
  await page.waitForSelector('.curve-place canvas');
  await curve(1);
  await page.waitForFunction(() => document.querySelectorAll('.lines li').length === 1);
  await page.click('#compare');
  await curve(2);
  await page.waitForFunction(() => document.querySelectorAll('.lines li').length === 2);
  await until('the cursor shows both values', async () => {
    const box = await page.locator('.curve-place').first().boundingBox();
    await page.mouse.move(box.x + 80 + 10 * Math.random(), box.y + 20);
    return /^\d+\.\d\d \/ \d+\.\d\d \(/.test(await page.locator('.curve output').first().innerText());
  });
  await shoot(page, 'curves');
  await curve(2);
  await page.waitForFunction(() => document.querySelectorAll('.lines li').length === 1);
  assertClean(visitor);
});

test('numbers per part are shown', async () => {
  const served = await worked();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await page.click('#evaluate');
  await page.waitForSelector('.numbers tbody tr:nth-child(2)');
  const [first, second] = await page.locator('.numbers tbody tr').allInnerTexts();
  assert.match(first, /^lot-1\s+2\s+100\.0 %\s+19\.\d\d ± \d\.\d\d mm/);
  assert.match(second, /^lot-2\s+1\s+100\.0 %\s+19\.\d\d ± – mm\s+–/);
  await page.fill('#part-filter', 'lot-2');
  await page.waitForFunction(() => !document.querySelector('.numbers'), null);
  assertClean(visitor);
});

test('a part shows its trend, distribution and limits, and its newest curves', async () => {
  const served = await worked();
  const recipe = { number: 1, width_mm: 20, accept_min_mm: 18, accept_max_mm: 22 };
  await served.ask('PUT', 'recipes/lot-1', recipe);
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await page.click('#evaluate');
  await page.click('.numbers button:has-text("lot-1")');
  await page.waitForSelector('.part-report .curve-place canvas');
  await page.waitForFunction(() => document.querySelectorAll('.part-report .lines li').length === 4);
  assert.equal(await page.locator('.histogram line').count(), 2);
  assert.match(await page.locator('.histogram').getAttribute('aria-label'), /^Distribution: .*mm: [12]/);
  assert.match(await page.locator('.part-report dl').innerText(), /Grips in the journal\s+2[\s\S]*Cpk/);
  await page.click('#part-curves');
  await page.waitForFunction(() => document.querySelectorAll('aside .lines li').length === 2);
  await shoot(page, 'part', { fullPage: true });
  await page.click('.numbers button:has-text("lot-2")');
  await page.waitForSelector('.part-report:has-text("lot-2")');
  await page.waitForFunction(() => document.querySelectorAll('.part-report .lines li').length === 2);
  await page.click('.numbers button:has-text("lot-2")');
  await page.waitForFunction(() => !document.querySelector('.part-report'));
  assertClean(visitor);
});

for (const [locale, words] of [
  ['en-GB', [/width 20 mm, speed 300 mm\/s, part lot-1/, /Home first|home first/, /force limit/]],
  ['de-DE', [/Weite 20 mm, Geschwindigkeit 300 mm\/s, Teil lot-1/, /erst Referenzfahrt/, /Kraftgrenze/]],
]) {
  test(`events are in words, ${locale}`, async () => {
    const served = await gateway();
    await post(served, 'left/grip', { width_mm: 20, speed_mm_s: 300 });
    await post(served, 'left/home');
    await served.ask('PUT', 'grippers/left/settings/force-limit', { force_n: 44 });
    await post(served, 'left/grip', { width_mm: 20, speed_mm_s: 300, part_id: 'lot-1' });
    const visitor = await visit(launched, served, { path: '/#/left/history', locale });
    const { page } = visitor;
    await page.click('[data-choice=records-events]');
    await page.waitForSelector('tr.bad');
    const text = await page.locator('tbody').innerText();
    for (const word of words) assert.match(text, word);
    assert.doesNotMatch(text, /_mm|_n\b|part_id|enabled/);
    assertClean(visitor);
  });
}

test('the report is printed without controls', async () => {
  const served = await worked();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  await page.evaluate(() => {
    globalThis.print = () => {
      globalThis.isPrinted = true;
    };
  });
  await page.selectOption('#kind', 'grip');
  await rows(page, 3);
  await page.click('#evaluate');
  await page.waitForSelector('.numbers');
  await page.click('#print');
  assert.ok(await page.evaluate(() => globalThis.isPrinted));
  await page.emulateMedia({ media: 'print' });
  for (const gone of ['.bar', '.filters', '#print', '.foot', 'tbody button'])
    assert.ok(!(await page.locator(gone).first().isVisible()), gone);
  for (const there of ['.printed:has-text("Grip")', '.numbers', '.split table'])
    assert.ok(await page.locator(there).isVisible(), there);
  await shoot(page, 'report', { fullPage: true });
  assertClean(visitor);
});
