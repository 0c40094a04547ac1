// Alarms of the gateway, which all browsers share.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, gateway, shoot, simulator, stopped, until, visit } from './harness.mjs';

const launched = await browser();

const GRIPPERS = 24;

test('one STOP of 24 grippers is acknowledged with two clicks, for all browsers', async () => {
  const more = Array.from({ length: GRIPPERS }, (_, index) => ['--gripper', `g${index + 1}=sim://wsg50`]).flat();
  const served = await gateway({ more });
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  for (const { page } of [anna, ben]) await page.waitForSelector('#take-control');
  await anna.page.keyboard.press('Escape');
  for (const { page } of [anna, ben]) await page.waitForSelector(`.alarm-badge:has-text("${GRIPPERS} alarms")`);
  const { alarms } = await served.ask('GET', 'alarms');
  await anna.page.click('#choose-alarms');
  const rows = await anna.page.locator('.chooser li').allInnerTexts();
  assert.equal(rows.length, GRIPPERS);
  for (const { gripper, fast_stop_id: id } of alarms) {
    const row = rows.find((text) => text.startsWith(`${gripper}: FAST STOP`));
    assert.ok(row.includes(`…${id.slice(-4)}`) && row.includes('127.0.0.1'), row);
  }
  await shoot(anna.page, 'alarms-chosen', { fullPage: true });
  await anna.page.click('#acknowledge-alarms:enabled');
  for (const { page } of [anna, ben]) await page.waitForSelector('.alarm-badge:has-text("No alarms")');
  const { grippers } = await served.ask('GET', 'grippers');
  for (const { gripper } of grippers) {
    assert.equal((await served.ask('GET', `grippers/${gripper}/state`)).fast_stop, false, gripper);
  }
  [anna, ben].forEach(assertClean);
});

test('a FAST STOP after the list was opened is not acknowledged with it', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  await stopped(page);
  await page.waitForSelector('.alarm-badge:has-text("2 alarms")');
  await page.click('#choose-alarms');
  await page.waitForSelector('#acknowledge-alarms:enabled');
  const later = await served.ask('POST', 'grippers/left/fast-stop', { reason: 'light curtain' });
  await page.click('#acknowledge-alarms');
  await page.waitForSelector('.alarms-panel .problem:has-text("left: FAST STOP")');
  await page.waitForSelector('.alarm-badge:has-text("1 alarm")');
  assert.equal((await served.ask('GET', 'grippers/left/state')).fast_stop_id, later.fast_stop_id);
  assert.equal((await served.ask('GET', 'grippers/right/state')).fast_stop, false);
  assertClean(visitor);
});

test('an alarm keeps its time over a reload, and is in the history', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  device.child.kill('SIGSTOP');
  await page.waitForSelector('.alarm:has-text("left: no link")');
  device.child.kill('SIGCONT');
  await page.waitForSelector('.alarm:has-text("cleared")');
  const shown = await page.locator('.alarm-text .small').innerText();
  await page.reload();
  await page.waitForSelector('.alarm:has-text("cleared")');
  assert.equal(await page.locator('.alarm-text .small').innerText(), shown);
  await page.click('.alarm button:has-text("Acknowledge")');
  await page.waitForSelector('.alarm-badge:has-text("No alarms")');
  await until('nobody has an alarm', async () => (await served.ask('GET', 'alarms')).alarms.length === 0);
  await page.click('[data-view=history]');
  await page.click('[data-choice=records-events]');
  await page.selectOption('#kind', 'alarm');
  for (const text of ['Alarm: no link', 'Alarm ended: no link', 'Alarm acknowledged: no link'])
    await page.waitForSelector(`tbody tr:has-text("${text}")`);
  await shoot(page, 'alarms-history', { fullPage: true });
  assertClean(visitor);
});
