// The guides that the gateway serves: search, contents, copied commands, and code that needs no sideways scrolling.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { violations } from './checks.mjs';
import { assertClean, browser, gateway, shoot, visit } from './harness.mjs';

const launched = await browser();

/** Makes copied text readable for the test, with the clipboard interface and without it. */
async function watchCopies(page) {
  await page.evaluate(() => {
    globalThis.copies = [];
    document.addEventListener('copy', () => globalThis.copies.push(String(document.activeElement.value)));
  });
  return () => page.evaluate(() => globalThis.copies.at(-1));
}

test('the search finds sections of other guides, without a connection to elsewhere', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/docs/guide/modbus' });
  const { page } = visitor;
  const first = page.locator('#results li a').first();
  await page.getByRole('searchbox').fill('stale_lease PLC shows');
  await first.waitFor();
  assert.equal(await first.textContent(), 'The PLC shows stale_lease (From a PLC)');
  assert.ok((await page.locator('#results mark').count()) > 0);
  await shoot(page, 'guide-search');
  await page.keyboard.press('Enter');
  await page.keyboard.press('Enter');
  await page.waitForURL('**/docs/guide/plc#the-plc-shows-stale_lease');

  await page.getByRole('searchbox').fill('kqzjx');
  await page.getByText('No section has all of these words.').waitFor();
  assert.equal(await page.locator('#results li').count(), 0);
  await page.getByRole('searchbox').fill('');
  await page.locator('#results').waitFor({ state: 'hidden' });
  assertClean(visitor);
  await visitor.close();
});

test('text in a guide that looks like HTML stays text in the results', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/docs/guide' });
  const { page } = visitor;
  await page.route('**/search.json', (route) =>
    route.fulfill({
      json: [
        { page: 'plc', guide: 'G', heading: '<img src=x>', anchor: 'a', text: 'needle <img src=x onerror=alert(1)>' },
      ],
    }),
  );
  await page.getByRole('searchbox').fill('needle');
  await page.locator('#results li a').waitFor();
  assert.equal(await page.locator('#results img').count(), 0);
  assertClean(visitor);
  await visitor.close();
});

test('a search that fails says so, and the next one works', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/docs/guide' });
  const { page, allowed } = visitor;
  allowed.connections = true;
  await page.route('**/search.json', (route) => route.abort('connectionrefused'));
  await page.getByRole('searchbox').fill('lease');
  await page.getByText('The gateway does not answer.').waitFor();
  await page.unroute('**/search.json');
  await page.getByRole('searchbox').fill('leases');
  await page.locator('#results li a').first().waitFor();
  assertClean(visitor);
  await visitor.close();
});

test('the contents lead to the sections', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/docs/guide/operation', width: 1600 });
  const { page } = visitor;
  await page.locator('#contents').getByRole('link', { name: 'Installation', exact: true }).click();
  await page.waitForURL('**#installation');
  assert.ok(await page.locator('#installation').isVisible());
  assertClean(visitor);
  await visitor.close();
});

// Browsers offer the clipboard interface only in secure contexts, so a plant network without TLS has none.
for (const hasClipboard of [true, false]) {
  test(`a block of commands is copied without its responses, ${hasClipboard ? 'with' : 'without'} the clipboard interface`, async () => {
    const served = await gateway();
    const visitor = await visit(launched, served, {
      path: '/docs/guide/plc',
      permissions: ['clipboard-read', 'clipboard-write'],
    });
    const { page } = visitor;
    if (!hasClipboard) await page.evaluate(() => Object.defineProperty(navigator, 'clipboard', { value: undefined }));
    const last = await watchCopies(page);
    const block = page.locator('.block', { hasText: '/grippers/left/status' }).first();
    await block.getByRole('button').click();
    await block.getByRole('button', { name: 'Copied' }).waitFor();
    const copied = hasClipboard ? await page.evaluate(() => navigator.clipboard.readText()) : await last();
    assert.equal(copied, 'curl http://127.0.0.1:8080/api/v1/grippers/left/status');
    assertClean(visitor);
    await visitor.close();
  });
}

for (const [name, width, colorScheme] of [
  ['phone', 360, 'light'],
  ['desk', 1600, 'dark'],
]) {
  test(`${name}: axe finds nothing, and code wraps`, async () => {
    const served = await gateway();
    for (const guide of ['', '/plc', '/operation', '/websocket', '/configuration']) {
      const visitor = await visit(launched, served, { path: `/docs/guide${guide}`, width, colorScheme });
      const { page } = visitor;
      assert.deepEqual(await violations(page), [], guide);
      const wide = await page.evaluate(() =>
        [...document.querySelectorAll('pre')]
          .filter((pre) => pre.scrollWidth > pre.clientWidth)
          .map((pre) => pre.textContent.slice(0, 80)),
      );
      assert.deepEqual(wide, [], guide);
      const pageWidth = await page.evaluate(() => document.documentElement.scrollWidth);
      assert.ok(pageWidth <= width, `${guide} is ${pageWidth} wide`);
      await shoot(page, `guide${guide.replace('/', '-')}-${name}`);
      assertClean(visitor);
      await visitor.close();
    }
  });
}
