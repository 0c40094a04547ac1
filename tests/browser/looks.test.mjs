// Appearance of the page, also checked with axe: several screen sizes, light and dark, German and English.
// `SCREENSHOTS=1` leaves screenshots in target/browser/screenshots, for visual review.

import assert from 'node:assert/strict';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { misfits, violations } from './checks.mjs';
import {
  assertClean,
  browser,
  gateway,
  homed,
  named,
  shoot,
  simulator,
  started,
  stopped,
  textsOf,
  token,
  visit,
} from './harness.mjs';

const launched = await browser();

/** WCAG requires 320 px: 1280 px at 400 %. */
const SIZES = {
  narrow: { width: 320, height: 568, hasTouch: true, isMobile: true },
  phone: { width: 390, height: 844, hasTouch: true, isMobile: true },
  panel: { width: 1280, height: 800, hasTouch: true },
  desk: { width: 1920, height: 1080 },
};
/** The longest possible name, without a place to break. */
const LONGEST = 'longest_possible_name_of_gripper';
const VIEWS = ['operate', 'history', 'log', 'device', 'all'];
/** Frames arrive by the hundred, so the log is paused first. */
async function pickAFrame(page) {
  await page.click('#with-updates');
  await page.waitForSelector('.frame');
  await page.click('#pause-log');
  await page.locator('.frame').first().click();
}

for (const [size, shape] of Object.entries(SIZES)) {
  for (const [language, colorScheme] of [
    ['en', 'light'],
    ['de', 'dark'],
  ]) {
    test(`${size}, ${language}, ${colorScheme}: axe finds nothing, and everything fits`, async () => {
      const isNarrow = size === 'narrow';
      const served = await gateway({
        more: isNarrow ? ['--gripper', `${LONGEST}=sim://wsg50?part_mm=20`, '--gripper', 'right=sim://wsg50'] : [],
      });
      const visitor = await visit(launched, served, {
        ...shape,
        colorScheme,
        locale: language === 'de' ? 'de-DE' : 'en-GB',
      });
      const { page } = visitor;
      if (isNarrow) {
        await named(page, LONGEST);
      }
      await homed(page);
      await page.fill('#speed', '150');
      await page.click('#grip:enabled');
      await page.waitForSelector('[data-outcome=PART_HELD]');
      assert.equal(await page.locator('html').getAttribute('lang'), language);
      await page.click('#grip:enabled');
      for (const view of VIEWS) {
        await page.click(`[data-view=${view}]`);
        await page.waitForFunction(
          (name) => document.querySelector(`[data-view=${name}]`).getAttribute('aria-current') === 'page',
          view,
        );
        if (view === 'history') await page.click('tbody button');
        if (view === 'log') await pickAFrame(page);
        if (view === 'history') await page.waitForSelector('.curve-place canvas');
        await page.evaluate(() => scrollTo(0, 0));
        await shoot(page, `${size}-${view}-${language}`);
        assert.deepEqual(await violations(page), [], view);
        assert.deepEqual(await misfits(page), [], view);
        await page.emulateMedia({ colorScheme: colorScheme === 'dark' ? 'light' : 'dark' });
        await page.waitForFunction((before) => document.documentElement.dataset.theme !== before, colorScheme);
        await shoot(page, `${size}-${view}-${language}-other`);
        assert.deepEqual(await violations(page), [], `${view}, other theme`);
        await page.emulateMedia({ colorScheme });
        await page.waitForFunction((before) => document.documentElement.dataset.theme === before, colorScheme);
      }
      await stopped(page);
      await page.click('[data-view=operate]');
      await page.waitForSelector('#acknowledge:enabled');
      await page.evaluate(() => scrollTo(0, 0));
      await shoot(page, `${size}-stopped-${language}`);
      await shoot(page, `${size}-stopped-${language}-whole`, { fullPage: true });
      assert.deepEqual(await violations(page), [], 'stopped');
      assert.deepEqual(await misfits(page), [], 'stopped');
      assertClean(visitor);
    });
  }
}

for (const [language, colorScheme] of [
  ['en', 'light'],
  ['en', 'dark'],
  ['de', 'light'],
  ['de', 'dark'],
]) {
  test(`axe finds nothing in error states, ${language}, ${colorScheme}`, async () => {
    const words = await textsOf(language);
    const device = await simulator();
    const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
    const settings = { ...SIZES.panel, colorScheme, locale: language === 'de' ? 'de-DE' : 'en-GB' };
    const visitor = await visit(launched, served, settings);
    const { page } = visitor;
    const look = async (what, at = page) => {
      await at.evaluate(() => scrollTo(0, 0));
      await shoot(at, `wrong-${what}-${language}-${colorScheme}`);
      assert.deepEqual(await violations(at), [], what);
      assert.deepEqual(await misfits(at), [], what);
    };
    await homed(page);
    await page.fill('#width', '1,000');
    await page.fill('#force', '500');
    await page.waitForSelector('.field.wrong #force');
    await look('mistake');
    await page.fill('#width', '20');
    await page.fill('#force', '30');
    await page.click('[data-view=log]');
    await page.fill('#editor-id', '07h');
    await page.click('#editor-send');
    await page.waitForSelector('.problem');
    await look('problem');
    await page.click('[data-view=operate]');
    await served.ask('POST', 'grippers/left/lease', { holder: 'robot', force: true, ttl_ms: 60_000 });
    await page.waitForSelector('.status:has-text("robot")');
    await page.click('#ask-control');
    await page.waitForSelector('#ask-control:disabled');
    await look('asked');
    await page.keyboard.press('Escape');
    await page.waitForSelector('#acknowledge:enabled');
    await look('latched');
    device.child.kill('SIGSTOP');
    await page.waitForSelector('.jaws-panel .cover');
    await page.waitForSelector('.alarm-badge[class*=tone]');
    await look('no-link');
    const deserted = await visit(launched, served, { ...settings, hasOwnTimes: true });
    await deserted.page.waitForSelector('#acknowledge');
    served.child.kill('SIGSTOP');
    deserted.allowed.connections = true;
    await deserted.page.waitForSelector(`.jaws-panel .cover:has-text("${words['stale.silent']}")`);
    await look('silent', deserted.page);
    for (const { child } of [served, device]) child.kill('SIGCONT');
    for (const one of [page, deserted.page]) await one.waitForFunction(() => !document.querySelector('.cover'));
    [visitor, deserted].forEach(assertClean);
  });
}

test('axe finds nothing on the page to sign in', async () => {
  const folder = mkdtempSync(join(tmpdir(), 'wsg-browser-'));
  started.push(() => rmSync(folder, { recursive: true }));
  const file = join(folder, 'tokens.json');
  const served = await gateway({ more: ['--tokens', file], secret: token(file, 'anna', 'operator') });
  for (const [size, locale, colorScheme, forcedColors] of [
    ['phone', 'en-GB', 'light', 'none'],
    ['panel', 'de-DE', 'dark', 'none'],
    ['desk', 'en-GB', 'dark', 'none'],
    ['panel', 'de-DE', 'light', 'active'],
  ]) {
    const { page, close } = await visit(launched, served, { ...SIZES[size], locale, colorScheme, forcedColors });
    await page.waitForSelector('.sign-in');
    // Nothing is claimed that the page cannot know.
    const words = await textsOf(locale.slice(0, 2));
    await page.waitForSelector(`.status:has-text("${words['bar.sign_in']}")`);
    assert.equal(await page.locator('.alarm-badge').innerText(), words['bar.alarms_unknown']);
    assert.equal(await page.locator('[data-view], [class*=tone-]').count(), 0);
    await shoot(page, `${size}-signin-${locale}-${colorScheme}-${forcedColors}`);
    assert.deepEqual(await violations(page), [], locale);
    assert.deepEqual(await misfits(page), [], locale);
    await close();
  }
});

test('axe finds nothing with forced colours', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { ...SIZES.panel, forcedColors: 'active' });
  const { page } = visitor;
  await homed(page);
  for (const view of VIEWS) {
    await page.click(`[data-view=${view}]`);
    await page.waitForSelector(`[data-view=${view}][aria-current=page]`);
    await page.waitForSelector('main h2');
    await shoot(page, `forced-${view}`);
    assert.deepEqual(await violations(page), [], view);
  }
  await stopped(page);
  await page.click('[data-view=operate]');
  await page.waitForSelector('#acknowledge:enabled');
  assert.deepEqual(await violations(page), [], 'stopped');
  assertClean(visitor);
});

test('a change of language translates every word', async () => {
  const de = await textsOf('de');
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.click('[data-choice=language-de]');
  await page.waitForSelector(`#take-control:has-text("${de['control.take']}")`);
  const shown = await page.locator('body').innerText();
  for (const key of ['motion.title', 'stop.not', 'chart.pause', 'command.grip', 'nav.history'])
    assert.ok(shown.includes(de[key]), key);
  await page.click('[data-view=device]');
  await page.waitForSelector(`.flags:has-text("${de['flag.REFERENCED']}")`);
  await page.waitForSelector(`.control-panel:has-text("${de['control.others']}")`);
  await page.click('[data-view=operate]');
  await page.reload();
  await page.waitForSelector(`#take-control:has-text("${de['control.take']}")`);
  assertClean(visitor);
});

test('everything works by keyboard', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('#take-control');
  const press = async (selector, key = 'Enter') => {
    for (let tabs = 0; tabs < 120; tabs += 1) {
      if (await page.evaluate((wanted) => document.activeElement?.matches(wanted), selector)) {
        await page.keyboard.press(key);
        return;
      }
      await page.keyboard.press('Tab');
    }
    assert.fail(`${selector} is not reached by Tab`);
  };
  await press('#take-control');
  await page.waitForSelector('#home:enabled');
  await press('#home');
  await page.waitForSelector('[data-outcome=SUCCESS]');
  await press('[data-view=history]');
  await page.waitForSelector('#export');
  await press('#stop', 'Space');
  await press('[data-view=operate]');
  await page.waitForSelector('#acknowledge:enabled');
  await press('#acknowledge');
  await page.waitForSelector('#grip:enabled');
  assertClean(visitor);
});
