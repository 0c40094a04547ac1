// A person's tasks on the page, in a real browser with the real gateway.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  altered,
  assertClean,
  browser,
  exchanged,
  gateway,
  homed,
  LATE_MESSAGES,
  shoot,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

const text = (page, selector) => page.locator(selector).first().innerText();

test('home, grip, hold, stop, see the cause, acknowledge', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  assert.ok(await page.locator('#home').isDisabled(), 'motion needs control');
  await page.click('#take-control');
  await page.waitForSelector('.why:has-text("Home first")');
  await page.waitForSelector('[data-notice=next]:has-text("home first")');
  await page.waitForSelector('#home.primary');
  await page.click('#home:enabled');
  await page.waitForSelector('[data-outcome=SUCCESS]');
  await page.waitForSelector('#grip.primary');
  await page.fill('#width', '20');
  await page.fill('#speed', '200');
  await page.fill('#part', 'lot-7');
  await page.click('#grip:enabled');
  await page.waitForSelector('[data-outcome=PART_HELD]');
  await page.waitForSelector('.jaws-words[data-state=HOLDING]');
  await page.waitForSelector('#release.primary');
  const state = await served.ask('GET', 'grippers/left/state');
  assert.equal(state.state, 'HOLDING');
  // The gateway's width can still change by the last update of the motion.
  await until('figure and drawing show the width', async () => {
    const { width_mm } = await served.ask('GET', 'grippers/left/state');
    const shown = Number((await text(page, '.figure-main .figure-value')).replace(/[^\d.]/g, ''));
    // The drawn part is as wide as the gap between the jaws: 540 units for 110 mm.
    const drawn = Number(await page.locator('.jaws .part').getAttribute('width'));
    return Math.abs(shown - width_mm) < 0.02 && Math.abs(drawn - (width_mm * 540) / 110) < 1;
  });
  await shoot(page, 'holding');

  await page.click('#stop');
  await page.waitForSelector('#latch-title');
  const stopped = await served.ask('GET', 'grippers/left/state');
  assert.equal(stopped.fast_stop, true);
  await until('STOP stops all grippers', async () => {
    const { fast_stop_id: id } = await served.ask('GET', 'grippers/right/state');
    return id === stopped.fast_stop_id;
  });
  // The browser's name is in the reason, not here.
  assert.equal(stopped.fast_stop_by, 'ws:127.0.0.1');
  assert.match(await text(page, '#latch-by'), /^tester-\d+ \(127\.0\.0\.1\), this browser$/);
  assert.match(await text(page, '.latch'), /dashboard, tester-/);
  assert.match(await text(page, '#latch-title'), new RegExp(`…${stopped.fast_stop_id.slice(-4)}`));
  assert.equal(await page.locator('#grip').count(), 0, 'the controls are covered');
  await shoot(page, 'stopped');
  await page.click('#acknowledge:enabled');
  await page.waitForSelector('#grip');
  assert.equal((await served.ask('GET', 'grippers/left/state')).fast_stop, false);
  assert.equal(
    (await served.ask('GET', 'grippers/right/state')).fast_stop,
    true,
    'only the shown gripper is acknowledged',
  );

  // The part's name is stored with the grip.
  await page.click('[data-view=history]');
  await page.fill('#part-filter', 'lot-7');
  await page.waitForSelector('tbody tr:first-child td:has-text("lot-7")');
  await page.click('tbody button');
  await page.waitForSelector('.curve-place canvas');
  await shoot(page, 'history');
  const [file] = await Promise.all([page.waitForEvent('download'), page.click('#export')]);
  assert.equal(file.suggestedFilename(), 'left-grips.csv');
  assert.match(await (await import('node:fs/promises')).readFile(await file.path(), 'utf8'), /lot-7/);
  assertClean(visitor);
});

test('an out-of-range value is not sent, and its field shows the limit', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.waitForSelector('#width-hint:has-text("0 – 110 mm")');
  for (const [id, wrong, hint] of [
    ['width', '111', /at most 110/],
    ['speed', '4', /at least 5/],
    ['force', '81', /at most 80/],
  ]) {
    const right = await page.inputValue(`#${id}`);
    await page.fill(`#${id}`, wrong);
    assert.match(await text(page, `#${id}-hint`), hint);
    assert.ok(await page.locator('#grip').isDisabled(), id);
    await page.fill(`#${id}`, right);
  }
  await page.fill('#width', '20,5');
  assert.ok(await page.locator('#grip').isEnabled(), 'a comma is a decimal separator');
  const before = await served.ask('GET', 'events?kind=refused');
  assert.deepEqual(before.events, []);
  // Soft limits narrow the accepted range.
  await page.click('[data-view=device]');
  await page.fill('#soft-limits-minus_mm', '10');
  await page.fill('#soft-limits-plus_mm', '60');
  await page.locator('form:has(#soft-limits-plus_mm) button[type=submit]').click();
  await page.click('[data-view=operate]');
  await page.waitForSelector('#width-hint:has-text("10 – 60 mm")');
  assert.ok((await page.locator('.jaws .forbidden rect').count()) >= 2);
  assertClean(visitor);
});

test('a jog moves only while it is held', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  // Slow enough that four jogs do not reach the end on a busy machine.
  await page.fill('#speed', '5');
  const state = () => served.ask('GET', 'grippers/left/state');
  const button = page.locator('#jog-close');
  await button.scrollIntoViewIfNeeded();
  for (const [how, press, release] of [
    ['by pointer', () => page.mouse.down(), () => page.mouse.up()],
    ['by key', () => page.keyboard.down('Space'), () => page.keyboard.up('Space')],
    [
      'left by the pointer outside',
      () => page.mouse.down(),
      async () => {
        await page.mouse.move(2, 2);
        await page.mouse.up();
      },
    ],
    [
      'left by a change of view',
      () => page.keyboard.down('Enter'),
      () => page.evaluate(() => document.querySelector('[data-view=history]').click()),
    ],
  ]) {
    await page.waitForSelector('#jog-close:enabled');
    await button.hover();
    await button.focus();
    const from = (await state()).width_mm;
    await press();
    await until(`the fingers move ${how}`, async () => (await state()).width_mm < from - 1);
    await release();
    await until(`the fingers stand after release ${how}`, async () => {
      const { moving, command } = await state();
      return moving === false && command === null;
    });
    const at = (await state()).width_mm;
    assert.ok(at > 5, `${how}: moved to the end, ${at}`);
    await page.keyboard.up('Enter');
    if (how.includes('view')) await page.click('[data-view=operate]');
  }
  assertClean(visitor);
});

test('earlier taps do not end a held jog', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await altered(page, ['LIVES_MS = 1000', 'LIVES_MS = 3000']);
  await homed(page);
  await page.waitForSelector('#jog-close:enabled');
  const state = () => served.ask('GET', 'grippers/left/state');
  const from = (await state()).width_mm;
  await page.locator('#jog-close').hover();
  for (let taps = 0; taps < 3; taps += 1) {
    await page.mouse.down();
    await page.mouse.up();
  }
  await page.mouse.down();
  // At 25 mm/s, longer than the lease lives without a renewal.
  await until('the fingers move while the jog is held', async () => (await state()).width_mm < from - 80);
  assert.equal((await state()).fast_stop, false);
  await page.mouse.up();
  await until('the fingers stand', async () => (await state()).moving === false);
  assert.equal((await state()).fast_stop, false);
});

test('a page that hangs during a jog stops the fingers', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { hasOwnTimes: true });
  const { page } = visitor;
  // Only the lease of the jog must end soon.
  await altered(page, ...LATE_MESSAGES);
  await homed(page);
  await page.fill('#speed', '5');
  await page.waitForSelector('#jog-close:enabled');
  const state = () => served.ask('GET', 'grippers/left/state');
  const from = (await state()).width_mm;
  await page.locator('#jog-close').hover();
  await page.mouse.down();
  await until('the fingers move', async () => (await state()).width_mm < from - 1);
  // The connection still answers pings, because the browser does that rather than the page.
  const hangs = page.evaluate(
    () =>
      new Promise((resolve) => {
        setTimeout(() => {
          const end = Date.now() + 5000;
          while (Date.now() < end);
          resolve();
        });
      }),
  );
  const stopped = await until('the gripper is stopped', async () => {
    const now = await state();
    return now.fast_stop ? now : null;
  });
  assert.equal(stopped.fast_stop_cause, 'client_lost');
  assert.ok(stopped.width_mm > 20, `at ${stopped.width_mm}`);
  await hangs;
  await page.mouse.up();
  await page.waitForSelector('.latch:has-text("was lost while the fingers moved")');
  assertClean(visitor);
});

test('frames and bytes are decoded, and the editor sends a command', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/log' });
  const { page } = visitor;
  await page.fill('#editor-id', '0x30');
  await page.fill('#editor-payload', '150.0f');
  assert.equal(await text(page, '#editor-frame'), 'aa aa aa 30 04 00 00 00 16 43 de cd');
  await page.click('#editor-send');
  await page.waitForSelector('#answer:has-text("E_SUCCESS")');
  await page.fill('#editor-id', '31h');
  await page.fill('#editor-payload', '');
  const send = () => page.click('#editor-send');
  await exchanged(page, send, '.frame.received:has-text("Acceleration"):has-text("150")');
  await page.waitForSelector('#answer [data-type=f32]:has-text("150")');
  await page.click('.frame.received:has-text("Acceleration")');
  await page.click('#with-hex');
  await page.waitForSelector('.frame .hex');
  // A float reply: its four bytes, selected from first to last.
  await page.locator('.frame.received', { hasText: '150' }).last().click();
  await page.locator('.byte').nth(8).click();
  await page
    .locator('.byte')
    .nth(11)
    .click({ modifiers: ['Shift'] });
  assert.equal(await text(page, '#meanings [data-type=f32]'), '150');
  await page.fill('#editor-payload', '0x20 nonsense');
  assert.match(await text(page, '#editor-payload-hint'), /nonsense/);
  assert.ok(await page.locator('#editor-send').isDisabled());
  // A refusal is shown in the gateway's words.
  await page.fill('#editor-id', '07h');
  await page.fill('#editor-payload', '');
  await page.click('#editor-send');
  await page.waitForSelector('.problem:has-text("07h")');
  await shoot(page, 'log');
  assertClean(visitor);
});
