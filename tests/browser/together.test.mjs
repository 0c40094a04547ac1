// Several users, and a gateway that goes away.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, controlled, gateway, homed, named, shoot, simulator, until, visit } from './harness.mjs';

const launched = await browser();

test('control is requested, handed over and taken back by force', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await named(anna.page, 'Anna');
  await named(ben.page, 'Ben');
  await anna.page.click('#take-control');
  await ben.page.waitForSelector('.status:has-text("Anna")');
  assert.ok(await ben.page.locator('#home').isDisabled());
  await ben.page.click('#ask-control');
  await anna.page.waitForSelector('[data-notice=asked]:has-text("Ben is asking for control")');
  await shoot(anna.page, 'asked', { fullPage: true });
  await anna.page.click('.strip:not([data-fresh]) #hand-over');
  await ben.page.waitForSelector('.take:has-text("You have control as Ben")');
  await anna.page.waitForSelector('.take:has-text("Ben has control")');
  await ben.page.click('#home:enabled');
  await until('Ben moves the fingers', async () => {
    const { events } = await served.ask('GET', 'events?kind=command');
    return events.some(({ command, phase }) => command === 'home' && phase === 'admitted');
  });
  await anna.page.waitForSelector('.last:has-text("Home")');

  await anna.page.click('#force-control');
  await anna.page.click('#force-control-sure');
  await anna.page.waitForSelector('.take:has-text("You have control as Anna")');
  await ben.page.waitForSelector('.take:has-text("Anna has control")');
  const events = await until('all changes are recorded', async () => {
    const { events: known } = await served.ask('GET', 'events?kind=lease&order=oldest');
    return known.length >= 4 && known;
  });
  assert.deepEqual(
    events.map(({ event, holder }) => [event, holder]),
    [
      ['taken', 'Anna'],
      ['requested', 'Ben'],
      ['handed_over', 'Ben'],
      ['forced', 'Anna'],
    ],
  );
  await anna.page.click('#give-back');
  await ben.page.waitForSelector('#take-control');
  [anna, ben].forEach(assertClean);
});

test('people are asked for their names, which others see', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served, { name: null }), await visit(launched, served)];
  await anna.page.waitForSelector('#take-control');
  assert.equal(await anna.page.inputValue('#my-name'), '');
  await anna.page.click('#take-control');
  // A click into the field takes nothing.
  await anna.page.click('#your-name');
  assert.equal((await served.ask('GET', 'grippers/left/state')).lease_holder, null);
  await anna.page.fill('#your-name', 'Anna');
  await anna.page.click('#your-name-set');
  await ben.page.waitForSelector('.status:has-text("Anna")');
  await anna.page.click('#stop');
  await anna.page.waitForSelector('#latch-by:has-text("Anna (127.0.0.1), this browser")');
  await ben.page.waitForSelector('#latch-by:has-text("Anna (127.0.0.1)")');
  assert.doesNotMatch(await ben.page.locator('#latch-by').innerText(), /this browser/);
  await ben.page.waitForSelector('.alarm:has-text("Anna (127.0.0.1)")');
  await ben.page.click('[data-view=history]');
  await ben.page.click('[data-choice=records-events]');
  await ben.page.waitForSelector('.stop-row:has-text("Anna (127.0.0.1)")');
  // The dashboard asks only once.
  await anna.page.click('[data-view=operate]');
  await anna.page.click('#acknowledge:enabled');
  await anna.page.click('#give-back');
  await anna.page.waitForSelector('#take-control');
  await anna.page.reload();
  await controlled(anna.page);
  assert.equal(await anna.page.locator('#your-name').count(), 0);
  [anna, ben].forEach(assertClean);
});

test('each request carries the user’s name, for all to see', async () => {
  const more = ['--gripper', 'left=sim://wsg50', '--gripper', 'away=tcp://127.0.0.1:1'];
  const served = await gateway({ more, connects: ['left'] });
  const path = '/#/left/operate';
  const [anna, ben] = [await visit(launched, served, { path }), await visit(launched, served, { path })];
  const who = 'Anna Müller (127.0.0.1)';
  await named(anna.page, 'Anna Müller');
  await anna.page.click('.alarm:has-text("away") button');
  await ben.page.waitForSelector(`.alarm:has-text("acknowledged by ${who}")`);
  await controlled(anna.page);
  const acceleration = '#acceleration-acceleration_mm_s2';
  await anna.page.click('[data-view=device]');
  // A value that arrives while the field is being filled would be appended.
  await until('the value is shown', async () => (await anna.page.inputValue(acceleration)) !== '');
  await anna.page.fill(acceleration, '1600');
  await anna.page.locator(`form:has(${acceleration}) button[type=submit]`).click();
  await anna.page.waitForSelector('.settings-panel:has-text("Applied.")');
  await anna.page.waitForSelector(`.others li:has-text("${who}, this browser")`);
  await ben.page.click('[data-view=device]');
  await ben.page.waitForSelector(`.others li:has-text("${who}")`);
  assert.doesNotMatch(await ben.page.locator('.others').innerText(), /this browser/);
  await ben.page.click('[data-view=history]');
  await ben.page.click('[data-choice=records-events]');
  await ben.page.waitForSelector(`tr:has-text("Acceleration"):has-text("${who}")`);
  const { events } = await served.ask('GET', 'events?kind=settings');
  assert.deepEqual([events[0].subject, events[0].label], ['ws:127.0.0.1', 'Anna Müller']);
  [anna, ben].forEach(assertClean);
});

test('a browser lost during a motion leaves a FAST STOP with that cause', async () => {
  const served = await gateway();
  const [goes, stays] = [await visit(launched, served), await visit(launched, served)];
  await homed(goes.page);
  await goes.page.fill('#width', '1');
  await goes.page.fill('#speed', '5');
  await goes.page.click('#move:enabled');
  await until('the fingers move', async () => (await served.ask('GET', 'grippers/left/state')).moving);
  await goes.close();
  await stays.page.waitForSelector('.latch:has-text("The client in control was lost")');
  assert.equal((await served.ask('GET', 'grippers/left/state')).fast_stop_cause, 'client_lost');
  assertClean(stays);
});

/** Time limit after the gateway's end, beyond which no old value may look live. */
const SHOWN_WITHIN_MS = 2000;

/** The same with all delays: a page that blocks itself is not excused. */
const SHOWN_AT_MOST_MS = 6000;

/**
 * Records when the page covers its values. Returns the text of the cover, and the milliseconds after `since`, by the clock
 * of this machine. Times during which the page did not run are left out, because a busy machine delays it.
 */
async function watchForCover(page) {
  await page.evaluate(() => {
    const everyMs = 50;
    let last = Date.now();
    const stalls = [];
    const tick = () => {
      const now = Date.now();
      const ms = now - last - everyMs;
      if (ms > everyMs) stalls.push({ until: now, ms });
      last = now;
    };
    setInterval(tick, everyMs);
    const look = () => {
      const cover = document.querySelector('.jaws-panel .cover');
      if (!cover || globalThis.covered) return;
      tick();
      globalThis.covered = { at: last, stalls, text: cover.innerText };
    };
    new MutationObserver(look).observe(document.body, { subtree: true, childList: true });
  });
  return async (since) => {
    const { at, stalls, text } = await (await page.waitForFunction(() => globalThis.covered)).jsonValue();
    assert.ok(at - since < SHOWN_AT_MOST_MS, `shown after ${at - since} ms, with ${JSON.stringify(stalls)}`);
    const lates = stalls.map(({ until: end, ms }) => Math.max(0, Math.min(ms, end - since)));
    return { afterMs: lates.reduce((afterMs, ms) => afterMs - ms, at - since), text };
  };
}

test('the page shows a lost gateway within 2 s, and recovers', async () => {
  const first = await gateway();
  const visitor = await visit(launched, first);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  assert.equal(await page.locator('.cover').count(), 0);
  visitor.allowed.connections = true;
  const covered = await watchForCover(page);
  const killedAt = Date.now();
  await first.kill('SIGKILL');
  const { afterMs } = await covered(killedAt);
  assert.ok(afterMs < SHOWN_WITHIN_MS, `shown after ${afterMs} ms`);
  await page.waitForSelector('.cover:has-text("Since")');
  await page.waitForSelector('.alarm:has-text("No connection to the gateway")');
  assert.equal(await page.locator('.jaws-words').count(), 0, 'no old value looks live');
  assert.ok(await page.locator('#stop').isEnabled(), 'STOP stays');
  await page.click('#stop');
  await page.waitForSelector('.stopped:has-text("did not get through")');
  await shoot(page, 'gone');
  await gateway({ port: first.port });
  await page.waitForFunction(() => !document.querySelector('.cover'));
  await page.click('#take-control');
  await page.waitForSelector('.status.tone-mine');
  assertClean(visitor);
});

test('a frozen gateway is noticed as soon as a lost one', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { hasOwnTimes: true });
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  const covered = await watchForCover(page);
  const frozenAt = Date.now();
  served.child.kill('SIGSTOP');
  try {
    const { afterMs, text } = await covered(frozenAt);
    assert.ok(afterMs < SHOWN_WITHIN_MS, `shown after ${afterMs} ms`);
    assert.match(text, /is not responding/);
  } finally {
    visitor.allowed.connections = true;
    served.child.kill('SIGCONT');
  }
  await page.waitForFunction(() => !document.querySelector('.cover'));
  assertClean(visitor);
});

test('an absent gripper is covered, with an alarm until acknowledged', async () => {
  // Nothing listens on TCP's discard port.
  const served = await gateway({
    more: ['--gripper', 'here=sim://wsg50', '--gripper', 'there=tcp://127.0.0.1:9'],
    connects: ['here'],
  });
  const visitor = await visit(launched, served, { path: '/#/there/operate' });
  const { page } = visitor;
  await page.waitForSelector('.jaws-panel .cover:has-text("not reached yet")');
  await page.waitForSelector('.alarm:has-text("there: not reached yet")');
  await page.click('.alarm button');
  await page.waitForSelector('.alarm:has-text("acknowledged")');
  await page.waitForSelector('.alarm-badge:has-text("No alarms")');
  await page.click('.chip:has-text("here")');
  await page.waitForSelector('#take-control');
  assert.equal(await page.locator('.jaws-panel .cover').count(), 0);
  assertClean(visitor);
});

test('a gripper with a lost link is covered, and recovers', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  device.child.kill('SIGSTOP');
  await page.waitForSelector('.jaws-panel .cover:has-text("Since")');
  assert.match(
    await page.locator('.jaws-panel .cover').innerText(),
    /The gripper is not responding|No link to the gripper/,
  );
  await page.waitForSelector('.alarm:has-text("left:")');
  device.child.kill('SIGCONT');
  await page.waitForFunction(() => !document.querySelector('.cover'));
  await page.waitForSelector('.alarm:has-text("cleared")');
  assertClean(visitor);
});

test('a fleet of two gateways shows which one is gone', async () => {
  const near = await gateway({ more: ['--name', 'cell-1', '--gripper', 'left=sim://wsg50'] });
  const visitor = await visit(launched, near, { path: '/#/left/all' });
  const { page } = visitor;
  await page.waitForSelector('p:has-text("No other gateways found")');
  const endpoint = await near.says(/Zenoh: (tcp\/127\.0\.0\.1:\d+)/);
  const far = await gateway({
    more: ['--name', 'cell-2', '--zenoh-connect', endpoint, '--gripper', 'right=sim://wsg50'],
  });
  await far.ask('POST', 'grippers/right/home');
  await far.ask('POST', 'grippers/right/lease', { holder: 'robot-1', ttl_ms: 60_000 });
  const row = (words) =>
    page.waitForFunction(
      (wanted) => [...document.querySelectorAll('tbody tr')].some((one) => new RegExp(wanted).test(one.innerText)),
      words,
    );
  await row('cell-1\\s+left\\s+connected');
  await row('cell-2\\s+right\\s+connected\\s+Idle\\s+robot-1\\s+\\d+ (ms|s)');
  await far.ask('POST', 'fast-stop');
  await row('cell-2\\s+right\\s+connected\\s+FAST STOP');
  await shoot(page, 'fleet');
  await far.kill('SIGKILL');
  await row('cell-2\\s+right\\s+gateway offline');
  await row('cell-1\\s+left\\s+connected');
  assertClean(visitor);
});

test('a reload of the configuration changes the grippers and the rights on an open page', async () => {
  const config = (role, ...names) => `
    [[clients]]
    name = "panel"
    address = "127.0.0.1"
    role = "${role}"
    ${names.map((name) => `[grippers.${name}]\nurl = "sim://wsg50"`).join('\n')}
  `;
  const served = await gateway({ toml: config('operator', 'left', 'right') });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('.chip:has-text("right")');
  await page.waitForSelector('#take-control');
  served.reload(config('observer', 'left', 'third'));
  await page.waitForSelector('.chip:has-text("third")');
  await page.waitForSelector('.chip:has-text("right")', { state: 'detached' });
  await page.waitForSelector('#take-control', { state: 'detached' });
  assertClean(visitor);
});
