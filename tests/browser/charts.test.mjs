// Charts that begin with the gateway's values.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, gateway, homed, named, until, visit } from './harness.mjs';

const launched = await browser();

test('charts show the time before a reload', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 50, speed_mm_s: 25 });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('.charts canvas');
  // Times before the page was opened are negative.
  await until('older samples are there', () => page.evaluate("find('left').samples.time(0) < 0"));
  const widths = await page.evaluate(
    "find('left').samples.window(-60000, performance.now(), 1000)[1].filter((width) => width !== null)",
  );
  // Samples of the way from 109 mm are 5 mm apart, or more on a busy machine.
  assert.ok(Math.max(...widths) > 80 && Math.abs(widths.at(-1) - 50) < 1, `${widths}`);
  assertClean(visitor);
});

test('the history names the user who moved a gripper', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await named(page, 'Anna');
  await homed(page);
  await page.click('[data-view=history]');
  await page.click('[data-choice=records-events]');
  await page.waitForSelector('tbody tr:has-text("Home"):has-text("Anna (127.0.0.1)")');
  assertClean(visitor);
});
