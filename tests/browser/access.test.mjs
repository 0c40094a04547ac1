// Accessibility beyond axe: focus, forced colours, unique names, and Escape in an open list.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, controlled, gateway, homed, shoot, stopped, until, visit } from './harness.mjs';

const launched = await browser();

const VIEWS = ['operate', 'history', 'log', 'device', 'all'];

/** The id of the focused element, or of its panel's title. */
const focused = (page) =>
  page.evaluate(() => {
    const { activeElement: one } = document;
    return one === document.body ? 'body' : one.id || one.closest('.panel')?.getAttribute('aria-labelledby');
  });

test('focus stays after Take control, a motion and Acknowledge', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.focus('#take-control');
  await page.keyboard.press('Enter');
  await page.waitForSelector('.status.tone-mine');
  await until('the focus stays in the panel', async () => ['control-title', 'give-back'].includes(await focused(page)));
  await page.focus('#home:enabled');
  await page.keyboard.press('Enter');
  await page.waitForSelector('.last[data-outcome=SUCCESS]');
  await until('the button has the focus again', async () => (await focused(page)) === 'home');
  await page.keyboard.press('Escape');
  await page.focus('#acknowledge:enabled');
  await page.keyboard.press('Enter');
  await page.waitForSelector('#grip:enabled');
  await until('the focus stays with the controls', async () => (await focused(page)) === 'motion-title');
  // After a click beside all buttons, the focus does not come back.
  await page.focus('#grip');
  await page.mouse.click(5, 700);
  await page.fill('#width', '30');
  await page.evaluate(() => document.activeElement.blur());
  await page.click('[data-choice=theme-dark]');
  await page.mouse.click(5, 700);
  await page.waitForFunction(() => document.activeElement === document.body);
  // Not even if the page changes at once.
  await page.focus('#grip:enabled');
  const isBody = await page.evaluate(async () => {
    document.activeElement.blur();
    document.getElementById('app').append(new Comment());
    await new Promise((resolve) => {
      setTimeout(resolve);
    });
    return document.activeElement === document.body;
  });
  assert.ok(isBody, 'a button that was left gets the focus back');
  assertClean(visitor);
});

test('focus comes back when old values are no longer covered', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { hasOwnTimes: true });
  const { page, allowed } = visitor;
  allowed.connections = true;
  for (const id of ['take-control', 'width']) {
    await until(`#${id} has the focus`, async () => {
      await page.focus(`#${id}`);
      return (await focused(page)) === id;
    });
    served.child.kill('SIGSTOP');
    await page.waitForSelector(`[inert] #${id}`);
    await page.waitForFunction(() => document.activeElement === document.body);
    served.child.kill('SIGCONT');
    await until(`#${id} has the focus again`, async () => (await focused(page)) === id);
  }
  assertClean(visitor);
});

test('Escape stops unless the browser keeps it, for an open list', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/history' });
  const { page } = visitor;
  let sent = 0;
  page.on('websocket', (socket) =>
    socket.on('framesent', ({ payload }) => {
      if (String(payload).includes('"fast-stop"')) sent += 1;
    }),
  );
  await page.reload();
  await page.click('#kind');
  await page.keyboard.press('Escape');
  await page.focus('#kind');
  await page.keyboard.press('Escape');
  await until('the gripper is stopped', async () => (await served.ask('GET', 'grippers/left/state')).fast_stop);
  await page.focus('#part-filter');
  await page.keyboard.press('Escape');
  await page.waitForSelector('.stopped:has-text("confirmed")');
  await until('each press is sent', () => sent >= 2);
  assert.equal(sent, 2, 'each press is one FAST STOP');
  assertClean(visitor);
});

/** Accessible names that several controls share. */
const sharedNames = (page) =>
  page.evaluate(() => {
    const shown = (one) => one.checkVisibility() && !one.closest('[inert]');
    const words = (one) => {
      const copy = one.cloneNode(true);
      copy.querySelectorAll('[aria-hidden=true]').forEach((hidden) => hidden.remove());
      return copy.textContent.replace(/\s+/g, ' ').trim();
    };
    const name = (one) => one.getAttribute('aria-label') ?? (one.labels?.[0] ? words(one.labels[0]) : words(one));
    const all = [...document.querySelectorAll('button, a[href], input, select, textarea, summary')].filter(shown);
    return [...Map.groupBy(all, name)].filter(([, some]) => some.length > 1).map(([shared]) => shared);
  });

test('every control of a view has its own name', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  for (const [button, outcome] of [
    ['#grip', 'PART_HELD'],
    ['#release', 'SUCCESS'],
  ]) {
    await page.click(`${button}:enabled`);
    await page.waitForSelector(`.last[data-outcome=${outcome}]`);
  }
  for (const view of VIEWS) {
    await page.click(`[data-view=${view}]`);
    if (view === 'history') await page.waitForSelector('tbody tr:nth-child(2)');
    assert.deepEqual(await sharedNames(page), [], view);
  }
  await stopped(page);
  await page.click('[data-view=operate]');
  await page.waitForSelector('.alarm:nth-child(2)');
  assert.deepEqual(await sharedNames(page), [], 'stopped');
  assertClean(visitor);
});

test('forced colours show what is selected', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { forcedColors: 'active' });
  const { page } = visitor;
  await controlled(page);
  await page.click('#stop');
  await page.waitForSelector('.alarm.tone-critical');
  const highlighted = (selector) =>
    page.evaluate((wanted) => {
      const probe = document.body.appendChild(document.createElement('p'));
      probe.style = 'forced-color-adjust: none; background: Highlight; color: HighlightText';
      const colours = (one) => {
        const { backgroundColor, color } = getComputedStyle(one);
        return `${color} on ${backgroundColor}`;
      };
      const isSame = colours(document.querySelector(wanted)) === colours(probe);
      probe.remove();
      return isSame;
    }, selector);
  for (const selected of [
    '[data-view=operate]',
    '.chip[aria-current=true]',
    '[data-choice=window-30]',
    '.status.tone-critical',
    '.alarm-badge',
    '.alarm',
    '.notice[class*=tone]',
  ]) {
    await page.waitForSelector(selected);
    assert.ok(await highlighted(selected), selected);
  }
  for (const other of ['[data-view=history]', '.chip[aria-current=false]', '[data-choice=window-10]'])
    assert.ok(!(await highlighted(other)), other);
  await page.click('[data-view=device]');
  await page.waitForSelector('.flag.set');
  assert.ok(await highlighted('.flag.set'));
  assert.ok(!(await highlighted('.flag:not(.set)')));
  await page.click('[data-view=operate]');
  await shoot(page, 'forced-colours', { fullPage: true });
  assertClean(visitor);
});
