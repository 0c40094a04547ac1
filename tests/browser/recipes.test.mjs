// Recipes: shared by browsers, changed in a form, and gripped with one tap.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { assertClean, browser, gateway, homed, shoot, until, visit } from './harness.mjs';

const launched = await browser();

/** Fills the fields of the open form, by the ends of their ids. */
async function fill(page, values) {
  for (const [field, value] of Object.entries(values)) await page.fill(`#recipe-${field}`, value);
}

test('a recipe of one browser is a single tap in another', async () => {
  const more = ['--gripper', 'left=sim://wsg50?part_mm=20', '--gripper', 'right=sim://wsg50'];
  const served = await gateway({ more });
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await homed(ben.page);
  await anna.page.click('#recipe-new');
  assert.equal(await anna.page.inputValue('#recipe-number'), '1');
  assert.ok(await anna.page.locator('#recipe-save').isDisabled(), 'a recipe needs a part');
  await fill(anna.page, { part: 'A-1047', number: '12', width_mm: '20', speed_mm_s: '200', accept_min_mm: '19' });
  await fill(anna.page, { accept_max_mm: '21', release_width_mm: '40', description: 'ring, left nest' });
  await shoot(anna.page, 'recipe-form', { fullPage: true });
  await anna.page.click('#recipe-save');
  await anna.page.waitForSelector('.recipe[data-recipe="12"]:has-text("ring, left nest")');
  const row = ben.page.locator('.recipe[data-recipe="12"]');
  await row.locator('[data-act="command.grip"]:enabled').click();
  await ben.page.waitForSelector('.result[data-result=HOLDING]:has-text("Part held")');
  await ben.page.click('#release:enabled');
  await ben.page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Release")');
  const width = async () => (await served.ask('GET', 'grippers/left/state')).width_mm;
  await until('the fingers are open', async () => Math.abs((await width()) - 40) < 0.5);

  // Another part is expected now, so the held one is wrong, and says so.
  await anna.page.click('.recipe[data-recipe="12"] [data-act="recipe.edit"]');
  await fill(anna.page, { accept_min_mm: '22', accept_max_mm: '23' });
  await anna.page.click('#recipe-save');
  await ben.page.waitForSelector('.recipe[data-recipe="12"]:has-text("22 – 23 mm")');
  await row.locator('[data-act="command.grip"]:enabled').click();
  await ben.page.waitForSelector('.result.tone-high[data-result=WRONG_PART]:has-text("contact at")');
  assert.match(await ben.page.locator('.result').innerText(), /Wrong part held[\s\S]*contact at (19|20)\.\d\d mm/);
  assert.equal(await ben.page.locator('.last .shape-check').count(), 0);
  await shoot(ben.page, 'wrong-part');
  // A Stop does not change the grip's result, and a new page learns its result.
  await ben.page.click('#stop-soft');
  await ben.page.waitForSelector('.last:has-text("Stop")');
  assert.equal(await ben.page.getAttribute('.result', 'data-result'), 'WRONG_PART');
  const cleo = await visit(launched, served);
  await cleo.page.waitForSelector('.result[data-result=WRONG_PART]:has-text("contact at")');
  await ben.page.click('#release:enabled');
  await ben.page.waitForFunction(() => !document.querySelector('.result'));

  await anna.page.click('.recipe[data-recipe="12"] [data-act="recipe.edit"]');
  await anna.page.click('#recipe-remove');
  await anna.page.click('#recipe-remove-sure:has-text("for everyone")');
  await row.waitFor({ state: 'detached' });
  await anna.page.click('[data-view=history]');
  await anna.page.click('[data-choice=records-events]');
  await anna.page.click('#of-all');
  await anna.page.waitForSelector('td:has-text("Recipe 12 (A-1047) removed")');
  [anna, ben, cleo].forEach(assertClean);
});

test('limits are proposed from grips, and a change in between is not overwritten', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const put = (accept_max_mm) =>
    served.ask('PUT', 'recipes/ring', {
      number: 3,
      width_mm: 20,
      speed_mm_s: 200,
      release_width_mm: 40,
      accept_max_mm,
    });
  await put(25);
  await served.ask('POST', 'grippers/left/home');
  for (let grips = 0; grips < 2; grips += 1) {
    await served.ask('POST', 'grippers/left/grip', { recipe: 3 });
    await served.ask('POST', 'grippers/left/release', { recipe: 3 });
  }
  await until('both grips are recorded', async () => (await served.ask('GET', 'grips')).grips.length === 2);
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await page.click('.recipe[data-recipe="3"] [data-act="recipe.edit"]');
  await page.click('#recipe-teach');
  await page.waitForSelector('.recipe-form:has-text("From 2 grips")');
  assert.match(await page.inputValue('#recipe-accept_max_mm'), /^(19|20)(\.\d+)?$/);
  await put(26);
  await page.click('#recipe-save');
  await page.waitForSelector('.recipe-form .problem:has-text("Someone else has changed this recipe")');
  assert.equal((await served.ask('GET', 'recipes/ring')).accept_max_mm, 26);
  // A second Save does not overwrite it either.
  await page.click('#recipe-save');
  await page.waitForSelector('.recipe-form .problem:has-text("Someone else has changed this recipe")');
  assert.equal((await served.ask('GET', 'recipes/ring')).accept_max_mm, 26);
  await page.click('.recipe-form button:has-text("Cancel")');
  await page.waitForSelector('.recipe[data-recipe="3"]:has-text("26 mm")');
  await page.click('.recipe[data-recipe="3"] [data-act="recipe.edit"]');
  assert.equal(await page.inputValue('#recipe-accept_max_mm'), '26');
  // A change of one field leaves the decimals of the others.
  await page.click('.recipe-form button:has-text("Cancel")');
  await put(26.125);
  await page.waitForSelector('.recipe[data-recipe="3"]:has-text("26.13 mm")');
  await page.click('.recipe[data-recipe="3"] [data-act="recipe.edit"]');
  await fill(page, { description: 'ring' });
  await page.click('#recipe-save');
  await page.waitForSelector('.recipe[data-recipe="3"] .tile-more:has-text("ring")');
  const { description, accept_max_mm: limit } = await served.ask('GET', 'recipes/ring');
  assert.deepEqual([description, limit], ['ring', 26.125]);
  assertClean(visitor);
});
