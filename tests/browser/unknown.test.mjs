// Values that the gripper no longer sends: they are shown as unknown, with the reason, and never as they were.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { misfits, violations } from './checks.mjs';
import { assertClean, browser, controlled, gateway, shoot, simulator, textsOf, until, visit } from './harness.mjs';

const launched = await browser();

/** Getters of the device. */
const ID = { flags: 0x40, state: 0x41, width: 0x43, force: 0x45, temperature: 0x46 };

const filled = (text, parameters) => text.replace(/\{(\w+)\}/g, (_, name) => parameters[name]);

/** A homed gripper at 50 mm whose getters can be broken, and a page that shows it. */
async function watched({ language = 'en', ...more } = {}) {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 50, speed_mm_s: 300 });
  const locale = language === 'de' ? 'de-DE' : 'en-GB';
  const visitor = await visit(launched, served, { locale, hasTouch: true, ...more });
  await controlled(visitor.page);
  const breaks = (...ids) => Promise.all(ids.map((id) => device.happens({ break_getter: { id, how: 'silent' } })));
  return { device, served, visitor, page: visitor.page, breaks, mends: () => device.happens('mend_getters') };
}

/** The newest width, or null for a gap. */
const lastWidth = (page) => page.evaluate("find('left').samples.window(-1e9, performance.now(), 1000)[1].at(-1)");

for (const language of ['en', 'de']) {
  test(`a width that is no longer sent is a dash with its reason, ${language}`, async () => {
    const words = await textsOf(language);
    const { visitor, page, breaks, mends } = await watched({ language });
    const reason = filled(words['unknown.missing'], { value: words['value.width_mm'] });
    const number = language === 'de' ? '50,00' : '50.00';
    await page.waitForSelector(`.figure-main .figure-value:has-text("${number}")`);
    await page.waitForSelector('.charts canvas');
    await breaks(ID.width);
    await page.waitForSelector(`.figure-main .figure-note:text-is("${reason}")`);
    assert.equal(await page.locator('.figure-main .figure-value').innerText(), '–');
    assert.equal(await page.locator('.figure-main .figure-value').getAttribute('title'), reason);
    assert.equal(await page.locator('.jaws').getAttribute('aria-label'), reason);
    assert.equal(await page.locator('.jaws-note').textContent(), words['unknown.width']);
    assert.equal(await page.locator('.jaws .dimension').count(), 0);
    const named = filled(words['unknown.values'], { values: words['value.width_mm'] });
    assert.equal(await page.locator('.unknown-values span').innerText(), named);
    const alarm = `left: ${words['alarm.value_unknown']} (${words['value.width_mm']})`;
    await page.waitForSelector(`.alarm:has-text("${alarm}")`);
    // The rest is known, and stays as it is.
    assert.equal(await page.locator('.cover').count(), 0);
    assert.equal(await page.locator('.figure-note').filter({ hasText: reason }).count(), 1);
    assert.equal(await page.locator('#move').isEnabled(), true);
    for (const step of await page.locator('.steps button').all()) assert.equal(await step.isEnabled(), false);
    await until('the chart has a gap at its end', async () => (await lastWidth(page)) === null);
    assert.equal(await page.locator(`.chart .gap-note:has-text("${reason}")`).count(), 1);
    await page.evaluate(() => scrollTo(0, 0));
    await shoot(page, `unknown-width-${language}`, { fullPage: true });
    assert.deepEqual(await violations(page), []);
    assert.deepEqual(await misfits(page), []);
    await page.setViewportSize({ width: 320, height: 568 });
    assert.deepEqual(await misfits(page), []);
    await page.setViewportSize({ width: 1280, height: 800 });
    await page.click('[data-view=all]');
    await page.waitForSelector(`.tile:has-text("${named}")`);
    const dash = page.locator(`.tile-figures [title="${reason}"]`);
    assert.deepEqual([await dash.innerText(), await dash.getAttribute('aria-label')], ['–', reason]);
    assert.equal(await page.locator('.gauge .gap').count(), 0);
    await page.waitForSelector(`[data-notice=alarm]:has-text("${alarm}")`);
    await shoot(page, `unknown-width-all-${language}`);
    assert.deepEqual(await violations(page), []);
    await mends();
    await page.waitForSelector('.gauge .gap');
    await page.click('[data-view=operate]');
    await page.waitForSelector(`.figure-main .figure-value:has-text("${number}")`);
    assert.equal(await page.locator('.unknown-values').count(), 0);
    assert.equal(await page.locator('.gap-note').count(), 0);
    await page.click('[data-view=history]');
    await page.click('[data-choice=records-events]');
    const values = { values: words['value.width_mm'], cause: 'not sent by the device' };
    await page.waitForSelector(`tbody tr:has-text("${filled(words['event.values_unknown'], values)}")`);
    await page.waitForSelector(`tbody tr:has-text("${filled(words['event.values_known'], values)}")`);
    const raised = `${words['alarm.value_unknown']} (${words['value.width_mm']})`;
    await page.waitForSelector(`tbody tr:has-text("${filled(words['event.alarm.raised'], { alarm: raised })}")`);
    await shoot(page, `unknown-width-history-${language}`);
    assertClean(visitor);
  });

  test(`without the flags, nothing is shown as live, ${language}`, async () => {
    const words = await textsOf(language);
    const { visitor, page, breaks, mends } = await watched({ language });
    await breaks(ID.flags);
    const cover = page.locator('.jaws-panel .cover');
    const reason = filled(words['stale.flags'], { values: words['value.flags'] });
    await cover.locator(`strong:text-is("${reason}")`).waitFor();
    const [since] = words['stale.flags_since'].split('{');
    assert.match(await cover.innerText(), new RegExp(`${since}\\d\\d:\\d\\d:\\d\\d`));
    assert.match(await cover.innerText(), /flags \(not sent by the device\)/);
    const states = page.locator('.statuses');
    assert.match(await states.innerText(), new RegExp(words['bar.unknown']));
    assert.equal(await states.locator(`[title="${reason}"]`).count(), 1);
    assert.equal(await page.locator('.motion-panel .cover').count(), 1);
    await page.locator('.motion-panel [inert] #home:disabled').waitFor();
    assert.equal(await page.locator('.result').count(), 0);
    await page.evaluate(() => scrollTo(0, 0));
    await shoot(page, `unknown-flags-${language}`, { fullPage: true });
    assert.deepEqual(await violations(page), []);
    await page.click('[data-view=device]');
    await page.waitForSelector('.flags-panel .cover');
    assert.equal(await page.locator('.flag.set').count(), 0);
    await page.click('[data-view=all]');
    await page.waitForSelector(`.tile:has-text("${reason}")`);
    await mends();
    await page.waitForSelector('.gauge .gap');
    await page.click('[data-view=device]');
    await page.waitForSelector('.flag.set');
    assertClean(visitor);
  });
}

test('an unknown state, force and temperature are named, and no result is derived from them', async () => {
  const { device, visitor, page, breaks } = await watched();
  await device.happens({ place_part: { width_mm: 20 } });
  await page.click('#grip:enabled');
  await page.waitForSelector('.result[data-result=HOLDING]');
  await breaks(ID.state, ID.force, ID.temperature);
  await page.waitForSelector('.unknown-values:has-text("State, Force, Temperature")');
  await page.waitForSelector('.statuses [title^="State unknown"]:has-text("unknown")');
  assert.match(await page.locator('.jaws-words').innerText(), /^Unknown/);
  assert.equal(await page.locator('.result').count(), 0);
  assert.equal(await page.locator('.jaws .part').count(), 0);
  await page.click('[data-view=device]');
  await page.waitForSelector('.flags-panel p:has-text("State unknown: the gripper sends no valid value")');
  assert.equal(await page.locator('.machine .current').count(), 0);
  await page.waitForSelector('dd:has-text("– (Temperature unknown: the gripper sends no valid value)")');
  assertClean(visitor);
});

test('a lost link shows no old value, and since when, also on a page that is opened later', async () => {
  const { device, visitor, page } = await watched();
  await page.waitForSelector('.figure-main .figure-value:has-text("50.00")');
  device.child.kill('SIGSTOP');
  try {
    const cover = page.locator('.jaws-panel .cover');
    await page.waitForFunction(() => document.querySelector('.figure-main .figure-value').textContent === '–');
    await cover.locator('p:has-text("The values are unknown.")').waitFor();
    assert.match(await cover.innerText(), /Since \d\d:\d\d:\d\d/);
    assert.match(await page.locator('.figure-main').textContent(), /Width unknown: /);
    assert.doesNotMatch(await page.locator('.jaws-panel').textContent(), /home first/);
    await page.reload();
    await cover.locator('p:has-text("The values are unknown.")').waitFor();
    assert.match(await cover.innerText(), /Since \d\d:\d\d:\d\d/);
  } finally {
    device.child.kill('SIGCONT');
  }
  await page.waitForSelector('.figure-main .figure-value:has-text("50.00")');
  assertClean(visitor);
});

test('until the link is called unresponsive, missing flags leave no state, result or motion', async () => {
  const { served, visitor, page } = await watched();
  await served.ask('POST', 'grippers/left/fast-stop');
  const latched = await served.ask('GET', 'grippers/left/state');
  await served.ask('POST', 'grippers/left/acknowledge', { fast_stop_id: latched.fast_stop_id });
  await page.waitForSelector('.result[data-result=ERROR]:has-text("Acknowledged")');
  await page.waitForSelector('#home:enabled');
  // A page that is loaded again would keep control, if it is back in time.
  await page.click('#give-back');
  await page.waitForSelector('#take-control');
  let hasFlags = false;
  await page.routeWebSocket('**/api/v1/ws', (socket) => {
    const server = socket.connectToServer();
    socket.onMessage((message) => server.send(message));
    server.onMessage((message) => {
      const parsed = JSON.parse(message);
      const unknown = { flags: [], flags_raw: null, referenced: null, moving: null, fast_stop: null, fault_code: 4 };
      for (const state of [parsed.params, parsed.result, ...(parsed.result?.states ?? [])])
        if (state?.flags && !hasFlags) Object.assign(state, unknown, { stale: ['flags'] });
      socket.send(JSON.stringify(parsed));
    });
  });
  await page.reload();
  await page.waitForSelector('.unknown-values:has-text("Unknown: Status flags.")');
  await controlled(page);
  await page.waitForSelector('.statuses [title^="Status flags unknown"]:has-text("unknown")');
  await page.waitForSelector('.why:has-text("Not possible: the status flags of the gripper are unknown.")');
  for (const id of ['grip', 'release', 'move', 'home', 'jog-open', 'jog-close'])
    assert.equal(await page.locator(`#${id}`).isEnabled(), false, id);
  assert.equal(await page.locator('.result').count(), 0);
  assert.equal(await page.locator('.chip .shape-on').count(), 0);
  await page.click('[data-view=device]');
  await page.waitForSelector('.flags-panel p:has-text("Status flags unknown")');
  assert.match(await page.locator('.flag').first().textContent(), /^–0referencedunknown$/);
  hasFlags = true;
  await page.waitForSelector('.flag.set');
  await page.click('[data-view=operate]');
  await page.waitForSelector('#home:enabled');
  assertClean(visitor);
});

test('the table of the fleet gives the reason for each unknown state and age', async () => {
  const { visitor, page } = await watched();
  const one = { gateway: 'cell-2', gone: false, link: 'connected', state: 'IDLE', age_ms: 5, fast_stop: false };
  const grippers = [
    { ...one, gripper: 'known' },
    { ...one, gripper: 'unclear', fast_stop: null },
    { ...one, gripper: 'lost', link: 'reconnecting', state: null, age_ms: null, fast_stop: null },
    { ...one, gripper: 'older', link: 'reconnecting', age_ms: 5000 },
    { ...one, gripper: 'gone', gateway: 'cell-3', gone: true, age_ms: 60_000 },
  ];
  await page.route('**/api/v1/fleet', (route) => route.fulfill({ json: { grippers } }));
  await page.click('[data-view=all]');
  const row = async (name) => (await page.locator(`tr:has(td:text-is("${name}"))`).innerText()).split(/\s*\t\s*/);
  await page.waitForSelector('tr:has(td:text-is("known"))');
  assert.deepEqual((await row('known')).slice(3), ['Idle', '–', '5 ms']);
  assert.deepEqual((await row('unclear')).slice(3), ['Unknown', '–', '5 ms']);
  assert.deepEqual((await row('lost')).slice(3), ['Unknown', '–', '–']);
  assert.deepEqual((await row('older')).slice(3), ['Unknown', '–', '5 s']);
  assert.deepEqual((await row('gone')).slice(3), ['Unknown', '–', '1 min']);
  for (const [label, count] of [
    ['Unknown, No value known', 1],
    ['Unknown, No link to the gripper', 2],
    ['No link to the gripper', 1],
    ['Unknown, gateway offline', 1],
  ])
    assert.equal(await page.locator(`tr [aria-label="${label}"]`).count(), count, label);
  assert.deepEqual(await violations(page), []);
  assertClean(visitor);
});
