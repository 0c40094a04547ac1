// The device view: fingers and diagnostics, and the tab's title.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, controlled, gateway, shoot, simulator, until, visit } from './harness.mjs';

const launched = await browser();

test('a finger fault leads to the fingers, with their flags in words', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  await device.happens({ finger_over_current: { finger: 1, on: true } });
  await page.click('.alarm button:has-text("Fingers")');
  await page.waitForSelector('[data-finger="1"] .finger-fault:has-text("power fault")');
  assert.equal(await page.locator('[data-finger="2"] .finger-fault').count(), 0);
  await shoot(page, 'fingers', { fullPage: true });
  assertClean(visitor);
});

test('a generic finger’s power is switched, and a force finger shows N', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?finger1=generic'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await controlled(page);
  await page.route('**/fingers/2', (route) =>
    route.fulfill({
      json: { finger: 2, type: 'WSG-FMF', type_code: 1, data_bytes: 4, flags: ['POWER_ON'], flags_raw: 1 },
    }),
  );
  await page.route('**/fingers/2/data', (route) => route.fulfill({ json: { finger: 2, data: '0000a041' } }));
  await page.click('[data-view=device]');
  await page.waitForSelector('[data-finger="2"]:has-text("20.0 N")');
  await page.click('[data-finger="1"] button:has-text("Power off")');
  await until(
    'the power is off',
    async () => !(await served.ask('GET', 'grippers/left/fingers/1')).flags.includes('POWER_ON'),
  );
  await page.waitForSelector('[data-finger="1"] button:has-text("Power on")');
  assertClean(visitor);
});

test('a finger set is named, counts its grips, and asks for maintenance', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  const panel = page.locator('section[aria-labelledby=finger-set-title]');
  await panel.locator('dd:has-text("none entered")').waitFor();
  await page.fill('#finger-set-cycles', '0');
  assert.equal(await page.locator('#finger-set-save').isDisabled(), true);
  await page.fill('#finger-set-id', 'F-12');
  await page.fill('#finger-set-cycles', '1');
  await page.click('#finger-set-save');
  await panel.locator('dd:has-text("0 / 1")').waitFor();
  await served.ask('POST', 'grippers/left/grip', { width_mm: 20, speed_mm_s: 300 });
  await served.ask('POST', 'grippers/left/release', { width_mm: 60, speed_mm_s: 300 });
  await panel.locator('.tone-low').waitFor();
  await page.click('[data-view=operate]');
  await page.waitForSelector(
    '.alarm:has-text("left: maintenance of the finger set due"):has-text("finger set F-12, grips: 1")',
  );
  await page.click('[data-view=device]');
  await page.click('#finger-set-reset');
  await page.click('#finger-set-reset-sure:has-text("Yes, reset")');
  await panel.locator('dd:has-text("0 / 1")').waitFor();
  assert.equal(await panel.locator('.tone-low').count(), 0);
  assertClean(visitor);
});

test('settings are read again when a device returns, and a new tag is shown everywhere', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const { page } = await visit(launched, served, { path: '/#/left/device' });
  let reads = 0;
  page.on('websocket', (socket) =>
    socket.on('framesent', ({ payload }) => {
      if (String(payload).includes('"settings.acceleration"')) reads += 1;
    }),
  );
  await page.reload();
  await until('the settings are read', () => reads > 0);
  await served.ask('PUT', 'grippers/left/settings/device-tag', { tag: 'cell 7' });
  await page.waitForSelector('section[aria-labelledby=device-title] dd:has-text("cell 7")');
  await until('the field shows the tag', async () => (await page.inputValue('#tag')) === 'cell 7');
  device.child.kill('SIGSTOP');
  await page.waitForSelector('.alarm-badge:has-text("1 alarm")');
  const before = reads;
  device.child.kill('SIGCONT');
  await until('the settings are read again', () => reads > before);
});

test('diagnostics are shown, and the title has the gateway and its alarms', async () => {
  const served = await gateway({ more: ['--name', 'cell-1', '--gripper', 'left=sim://wsg50'] });
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  const panel = '.panel:has(#health-title)';
  await page.waitForSelector(`${panel}:has-text("cell-1, ")`);
  await page.waitForSelector(`${panel} dd:has-text("per second")`);
  assert.match(await page.locator(panel).innerText(), /Round trip\s+\d+\.\d\d ms\s+Damaged frames\s+0/);
  await page.waitForFunction(() => document.title === 'left – cell-1');
  await page.click('#stop');
  await page.waitForFunction(() => document.title === '(1) left – cell-1');
  assertClean(visitor);
});
