// The first tasks of a new operator on a tablet, in German. Each touch is counted, and hits something that is in view.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';

import { assertClean, browser, gateway, shoot, simulator, textsOf, until, visit } from './harness.mjs';

const launched = await browser();
const de = await textsOf('de');

const TABLET = { width: 1024, height: 768, hasTouch: true, locale: 'de-DE' };

/** A finger that counts its touches. It touches only the middle of what is wholly in view: it never scrolls. */
function fingerOn(page) {
  let touches = 0;
  const touch = async (selector) => {
    const target = page.locator(selector).first();
    await target.waitFor();
    // A person needs longer than half a second to look for the next button.
    await page.waitForSelector('html:not([data-pressed])');
    await page.waitForSelector('.strip[data-fresh]', { state: 'detached' });
    const place = await target.boundingBox();
    const at = { x: place.x + place.width / 2, y: place.y + place.height / 2 };
    const isInView = await target.evaluate((one, { x, y }) => {
      const { left, top, right, bottom } = one.getBoundingClientRect();
      const isWhole = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
      const hit = document.elementFromPoint(x, y);
      return isWhole && hit !== null && one.contains(hit);
    }, at);
    assert.ok(isInView, `${selector} is in view: ${JSON.stringify(place)}`);
    await page.touchscreen.tap(at.x, at.y);
    touches += 1;
  };
  /** Returns the number of touches since the last call. */
  const count = () => {
    const counted = touches;
    touches = 0;
    return counted;
  };
  return { touch, count };
}

/** Asserts that a text can be read without scrolling. */
async function readable(page, selector) {
  const target = page.locator(selector).first();
  await target.waitFor();
  const place = await target.boundingBox();
  const isInView =
    place.x >= 0 && place.y >= 0 && place.x + place.width <= TABLET.width && place.y + place.height <= TABLET.height;
  assert.ok(isInView, `${selector} can be read: ${JSON.stringify(place)}`);
}

test('touches of a new operator, from Home to the export', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`, '--gripper', 'right=sim://wsg50'] });
  await device.happens({ place_part: { width_mm: 20 } });
  const recipe = { number: 1, width_mm: 20, speed_mm_s: 200, force_n: 30, release_width_mm: 40 };
  await served.ask('PUT', 'recipes/A-1047', recipe);
  const visitor = await visit(launched, served, { ...TABLET, name: null });
  const { page } = visitor;
  const { touch, count } = fingerOn(page);
  const figures = {};
  const done = (what, most) => {
    figures[what] = count();
    assert.ok(figures[what] <= most, `${what}: ${figures[what]} touches, at most ${most}`);
  };

  // The browser asks for the name once.
  await touch('#take-control');
  await page.waitForSelector('#your-name:focus');
  await page.keyboard.type('Anna');
  await touch('#your-name-set');
  await page.waitForSelector('.status.tone-mine');
  done('take control for the first time', 2);

  await readable(page, `[data-notice=next]:has-text("${de['next.home']}")`);
  await touch('#home:enabled');
  await page.waitForSelector('.last[data-outcome=SUCCESS]');
  done('home', 1);

  await touch('.recipe:has-text("A-1047") .tile-grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  await readable(page, `.result:has-text("${de['result.held']}")`);
  done('grip by recipe', 1);

  await touch('#release:enabled');
  await page.waitForSelector(`.last[data-outcome=SUCCESS]:has-text("${de['command.release']}")`);
  done('release', 1);

  await touch('.recipe:has-text("A-1047") .tile-grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  count();
  await device.happens('take_part');
  await readable(page, `.result:has-text("${de['state.PART_LOST']}")`);
  await readable(page, `[data-notice=next]:has-text("${de['next.release']}")`);
  await touch('#release:enabled');
  await page.waitForSelector('#grip.primary:enabled');
  done('go on after a lost part', 1);

  await touch('[data-view=history]');
  await page.waitForSelector('#export');
  count();
  await served.ask('POST', 'grippers/left/fast-stop', { reason: 'Lichtvorhang' });
  await touch('#show-worst');
  await readable(page, '#latch-by:has-text("127.0.0.1")');
  await readable(page, '.latch q:has-text("Lichtvorhang")');
  await shoot(page, 'newcomer-stopped');
  done('learn who stopped the gripper, and why', 4);
  await touch('#acknowledge:enabled');
  await page.waitForSelector('#grip');
  done('acknowledge', 1);

  await touch('[data-view=history]');
  await touch('[data-choice=records-events]');
  await readable(page, '.stop-row:has-text("Lichtvorhang") td:last-child:has-text("127.0.0.1")');
  await shoot(page, 'newcomer-history');
  done('learn later who stopped the gripper, and why', 4);

  await touch('[data-view=operate]');
  count();
  await served.ask('POST', 'grippers/right/fast-stop');
  await touch('#show-worst');
  await touch('#acknowledge:enabled');
  await until('it is acknowledged', async () => !(await served.ask('GET', 'grippers/right/state')).fast_stop);
  done('acknowledge the FAST STOP of the other gripper', 2);

  await touch('.alarm-badge');
  await touch(`.alarm:has-text("${de['alarm.part_lost']}") button`);
  await until('no alarm is left', async () => (await served.ask('GET', 'alarms')).alarms.length === 0);
  done('acknowledge the alarm of the lost part', 2);

  await touch('.chip:has-text("left")');
  await touch('[data-view=history]');
  await touch('[data-choice=range-hour]');
  await page.waitForSelector('tbody tr');
  const [file] = await Promise.all([page.waitForEvent('download'), touch('#export')]);
  assert.match(await readFile(await file.path(), 'utf8'), /;/);
  done('export the last hour', 4);

  console.log(JSON.stringify(figures));
  assertClean(visitor);
});

test('two touches grip by recipe, for an operator whom the browser knows', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  await served.ask('POST', 'grippers/left/home');
  for (const number of [1, 2, 3, 4, 5, 6])
    await served.ask('PUT', `recipes/A-${number}`, { number, width_mm: 20, speed_mm_s: 200, release_width_mm: 40 });
  const visitor = await visit(launched, served, TABLET);
  const { page } = visitor;
  const { touch, count } = fingerOn(page);
  await touch('#take-control');
  await touch('.recipe:has-text("A-6") .tile-grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  assert.equal(count(), 2);
  assertClean(visitor);
});
