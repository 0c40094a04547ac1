// Layout and navigation: what must be in view, many grippers, German texts, Back, and values by hand.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  assertClean,
  browser,
  controlled,
  gateway,
  homed,
  named,
  shoot,
  stopped,
  textsOf,
  until,
  visit,
} from './harness.mjs';

const allTexts = (await Promise.all(['de', 'en'].map(textsOf))).flatMap(Object.entries);
const launched = await browser();

const SIZES = {
  phone: { width: 390, height: 844, hasTouch: true, isMobile: true },
  panel: { width: 1280, height: 800, hasTouch: true },
};
const MANY = 24;
const VIEWS = ['operate', 'history', 'log', 'device', 'all'];

const cell = (count) =>
  gateway({
    more: Array.from({ length: count }, (_, index) => [
      '--gripper',
      `greifer${index + 1}=sim://wsg50?part_mm=20`,
    ]).flat(),
  });

for (const [size, shape] of Object.entries(SIZES)) {
  test(`result, notices, alarms and control are in view without scrolling, ${size}`, async () => {
    const served = await cell(MANY);
    const visitor = await visit(launched, served, { ...shape, locale: 'de-DE' });
    const { page } = visitor;
    await homed(page);
    await page.fill('#speed', '300');
    await page.click('#grip:enabled');
    await page.waitForSelector('[data-outcome=PART_HELD]');
    await served.ask('POST', 'grippers/greifer1/lease', { holder: 'Roboter 17', request: true });
    await served.ask('POST', 'grippers/greifer2/fast-stop');
    await page.waitForSelector('[data-notice=asked]');
    await page.waitForSelector('#notices-more');
    await page.waitForSelector('.result');
    await page.evaluate(() => scrollTo(0, 0));
    await shoot(page, `fold-${size}`);
    await page.click('#notices-more');
    await page.waitForSelector('.strip-list [data-notice=alarm]:has-text("greifer2")');
    await page.click('#notices-more');
    const hidden = await page.evaluate(() => {
      const views = document.querySelector('.views').getBoundingClientRect();
      const end = views.bottom > innerHeight - 5 ? views.top : innerHeight;
      return ['.result', '.strip', '#notices-more', '.alarm-badge', '.take', '.stop'].filter((wanted) => {
        const { top, bottom, left, right } = document.querySelector(wanted).getBoundingClientRect();
        return top < 0 || bottom > end || left < 0 || right > innerWidth;
      });
    });
    assert.deepEqual(hidden, []);
    assertClean(visitor);
  });
}

test('the page’s own reads leave room for the user’s requests', async () => {
  const served = await cell(MANY);
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const open = new Set();
  let most = 0;
  page.on('websocket', (socket) => {
    socket.on('framesent', ({ payload }) => {
      const { id, method } = JSON.parse(payload);
      // The regular polls are more if their answers come late.
      if (method !== 'state') open.add(id);
      most = Math.max(most, open.size);
    });
    socket.on('framereceived', ({ payload }) => open.delete(JSON.parse(payload).id));
  });
  await page.reload();
  await page.selectOption('#gripper-list', `greifer${MANY}`);
  await page.waitForSelector('#width-hint:has-text("0 – 110 mm")');
  // The gateway refuses more than 32 on a connection.
  assert.ok(most > 0 && most <= 16, `${most} requests at the same time`);
  assertClean(visitor);
});

test('every gripper of many can be reached, in the order of their numbers', async () => {
  const served = await cell(MANY);
  const visitor = await visit(launched, served, SIZES.phone);
  const { page } = visitor;
  await page.waitForSelector('#gripper-list');
  const names = await page.locator('#gripper-list option').evaluateAll((all) => all.map(({ value }) => value));
  assert.deepEqual(
    names,
    Array.from({ length: MANY }, (_, index) => `greifer${index + 1}`),
  );
  await page.selectOption('#gripper-list', `greifer${MANY}`);
  await page.waitForSelector(`#jaws-title:has-text("greifer${MANY}")`);
  await served.ask('POST', 'grippers/greifer3/fast-stop');
  await page.waitForFunction(() => /FAST STOP/.test(document.querySelector('#gripper-list option:nth-child(3)').text));
  assertClean(visitor);
});

test('Back returns to the previous view, and control stays', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await controlled(page);
  await page.click('[data-view=history]');
  await page.waitForSelector('#export');
  await page.click('[data-view=log]');
  await page.waitForSelector('#editor-send');
  await page.goBack();
  await page.waitForSelector('#export');
  await page.goBack();
  await page.waitForSelector('.take');
  assert.ok(await page.locator('.status.tone-mine').isVisible());
  await page.click('[data-view=all]');
  await page.click('[data-gripper=right]');
  await page.waitForSelector('#jaws-title:has-text("right")');
  await page.goBack();
  await page.waitForSelector('#all-title');
  assertClean(visitor);
});

test('a chosen curve comes into view on a phone', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  for (let turn = 0; turn < 6; turn += 1)
    await served.ask('POST', 'grippers/left/move', { width_mm: turn % 2 ? 60 : 70, speed_mm_s: 300 });
  const visitor = await visit(launched, served, { ...SIZES.phone, path: '/#/left/history' });
  const { page } = visitor;
  await page.click('tbody button >> nth=3');
  await page.waitForFunction(() => {
    const plot = document.querySelector('.curve-place canvas')?.getBoundingClientRect();
    const bar = document.querySelector('.bar').getBoundingClientRect();
    return (
      plot && plot.top >= bar.bottom && plot.bottom <= document.querySelector('.views').getBoundingClientRect().top
    );
  });
  assertClean(visitor);
});

/** Widths of phones, and of a panel. */
const WIDTHS = {
  narrow: { width: 320, height: 568 },
  small: { width: 361, height: 640 },
  ...SIZES,
};

/** The texts of all languages whose keys match. */
const texts = (wanted) => allTexts.filter(([key]) => wanted.test(key)).map(([, text]) => text);

/** Those of the texts that are cut in an item of the bar, once it is shown. */
const cutInBar = (page, index, all) =>
  until('the item is shown', () =>
    page.evaluate(
      ([at, given]) => {
        const place = document.querySelectorAll('.status-text > span')[at];
        if (place.clientWidth === 0) return null;
        const { firstChild } = place;
        const shown = firstChild.data;
        const range = document.createRange();
        range.selectNode(firstChild);
        const around = place.closest('.status').getBoundingClientRect();
        const found = given.filter((text) => {
          firstChild.data = text;
          const box = range.getBoundingClientRect();
          return box.right > around.right + 0.1 || box.bottom > around.bottom + 0.1 || box.top < around.top - 0.1;
        });
        firstChild.data = shown;
        return found;
      },
      [index, all],
    ),
  );

const TEXT_PLACES =
  'button, label, h2, h3, legend, th, .status-text > span, .alarm-badge > span, .figure-label, .tile-state, .take p';

/** Texts of the page that are cut, and words that are broken. */
const cut = (page) =>
  page.evaluate((places) => {
    /** Exact places of a text; an element's own width is rounded. */
    const ranged = (set) => {
      const range = document.createRange();
      set(range);
      return range;
    };
    const needs = (one) => ranged((range) => range.selectNodeContents(one)).getBoundingClientRect().width;
    const all = [...document.querySelectorAll(places)].filter((one) => one.checkVisibility() && one.clientWidth > 1);
    const tooWide = all
      .filter((one) => needs(one) > one.getBoundingClientRect().width + 0.1)
      .map((one) => `${one.innerText} needs ${needs(one)} of ${one.getBoundingClientRect().width}`);
    const nodes = all.flatMap((one) => {
      const walker = document.createTreeWalker(one, NodeFilter.SHOW_TEXT);
      const found = [];
      while (walker.nextNode()) found.push(walker.currentNode);
      return found;
    });
    const broken = nodes.flatMap((node) =>
      [...node.data.matchAll(/[\p{L}\d.,]+/gu)].flatMap(({ 0: word, index }) => {
        const place = ranged((range) => {
          range.setStart(node, index);
          range.setEnd(node, index + word.length);
        });
        return place.getClientRects().length > 1 ? `${word} is broken` : [];
      }),
    );
    return [...tooWide, ...broken];
  }, TEXT_PLACES);

for (const [size, shape] of Object.entries(WIDTHS)) {
  test(`no German text is cut or broken within a word, ${size}`, async () => {
    const served = await gateway();
    const visitor = await visit(launched, served, { ...shape, locale: 'de-DE' });
    const { page } = visitor;
    await named(page, 'Anna');
    await page.waitForSelector('#take-control:enabled');
    assert.deepEqual(await cut(page), [], 'free');
    await homed(page);
    assert.deepEqual(await cutInBar(page, 1, texts(/^state\.(?!ERROR|NO_PART|PART_LOST)/)), []);
    for (const view of VIEWS) {
      await page.click(`[data-view=${view}]`);
      await page.waitForFunction((name) => location.hash.endsWith(name), view);
      await page.waitForSelector('main h2');
      assert.deepEqual(await cut(page), [], view);
    }
    await stopped(page);
    await page.click('[data-view=operate]');
    await page.waitForSelector('#acknowledge:enabled');
    assert.deepEqual(await cut(page), [], 'stopped');
    assert.deepEqual(await cutInBar(page, 1, texts(/^state\./)), []);
    const deserted = await visit(launched, served, { ...shape, locale: 'de-DE', hasOwnTimes: true });
    await deserted.page.waitForSelector('#acknowledge');
    deserted.allowed.connections = true;
    served.child.kill('SIGSTOP');
    await deserted.page.waitForSelector('.cover:has-text("Gateway")');
    assert.deepEqual(await cut(deserted.page), [], 'silent');
    assert.deepEqual(await cutInBar(deserted.page, 0, texts(/^(link|bar\.gateway|bar\.sign_in)\b/)), []);
    [visitor, deserted].forEach(assertClean);
  });
}

test('values by hand become a recipe', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.fill('#width', '20.5');
  await page.fill('#open', '44');
  await page.fill('#part', 'ring');
  await page.click('#hand-save');
  assert.equal(await page.inputValue('#recipe-part'), 'ring');
  assert.equal(await page.inputValue('#recipe-width_mm'), '20.5');
  await page.click('#recipe-save');
  await page.click('.recipe:has-text("ring") [data-act="command.grip"]:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  // Release opens as far as the recipe of the held part says.
  await page.waitForSelector('#release:has-text("44 mm")');
  await page.click('#release:enabled');
  const width = async () => (await served.ask('GET', 'grippers/left/state')).width_mm;
  await until('the fingers are open', async () => Math.abs((await width()) - 44) < 0.5);
  await page.waitForSelector('.recipe.chosen:has-text("part held")');
  // A typed value means this value.
  await page.click('#by-hand summary');
  await page.fill('#width', '30');
  await page.waitForSelector('#grip:has-text("30 mm")');
  assert.equal(await page.locator('.recipe.chosen').count(), 0);
  assertClean(visitor);
});

test('charts show the value under the cursor, and their axes have distinct labels', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 60, speed_mm_s: 300 });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const drawn = [];
  await page.exposeFunction('noteLabel', (text) => drawn.push(text));
  await page.evaluate(() => {
    const { fillText } = CanvasRenderingContext2D.prototype;
    CanvasRenderingContext2D.prototype.fillText = function noted(text, ...place) {
      globalThis.noteLabel(text);
      return fillText.call(this, text, ...place);
    };
  });
  await page.waitForSelector('.chart canvas');
  await page.locator('.legend').scrollIntoViewIfNeeded();
  const box = await page.locator('.chart-place').first().boundingBox();
  await page.mouse.move(box.x + box.width - 20, box.y + box.height / 2);
  await page.waitForSelector('.chart:nth-child(1) output:has-text("60.00 (-")');
  await page.waitForSelector('.chart:nth-child(2) output:has-text("0.00 (-")');
  await page.click('[data-view=history]');
  await page.click('tbody tr:has-text("Move") button');
  await page.waitForSelector('.curve-place canvas');
  drawn.length = 0;
  await page.click('[data-choice=theme-dark]');
  await until('the curve is drawn again', () => drawn.length > 10);
  // The labels of an axis are drawn one after the other, and neighbours must differ.
  assert.deepEqual(
    drawn.filter((label, index) => label !== '' && label === drawn[index + 1]),
    [],
  );
  assertClean(visitor);
});

test('the jaws stay inside the body, with their width beside them', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 110, speed_mm_s: 300 });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('.figure-main .figure-value:has-text("110.00")');
  // A horizontal line has no height, so it counts as invisible.
  await page.waitForSelector('.jaws .dimension line', { state: 'attached' });
  const [body, ...jaws] = await page.evaluate(() =>
    ['.jaws .body', '.jaws .jaw', '.jaws g + g .jaw'].map((one) => {
      const { left, right } = document.querySelector(one).getBoundingClientRect();
      return { left, right };
    }),
  );
  for (const jaw of jaws) assert.ok(jaw.left >= body.left && jaw.right <= body.right, JSON.stringify({ body, jaw }));
  assertClean(visitor);
});

test('the ruler reads as the width that it shows', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 60, speed_mm_s: 300 });
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.waitForSelector('.figure-main .figure-value:has-text("60.00")');
  const [labels, fingers] = await page.evaluate(() => {
    const number = (element, name) => Number(element.getAttribute(name));
    const ruler = [...document.querySelectorAll('.jaws .ruler text')].filter((one) => one.textContent === '60');
    const width = document.querySelector('.jaws .dimension line');
    const at = [...ruler.map((one) => number(one, 'x')), number(width, 'x1'), number(width, 'x2')];
    return [at.slice(0, 2), at.slice(2)];
  });
  labels.forEach((at, index) => assert.ok(Math.abs(at - fingers[index]) < 1, `${labels} ${fingers}`));
  assertClean(visitor);
});
