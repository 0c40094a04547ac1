// Displayed values: current settings and results, late answers, and ambiguous input.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  altered,
  assertClean,
  browser,
  controlled,
  gateway,
  homed,
  LATE_ANSWERS,
  named,
  rendered,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

test('another client’s change of a setting is shown, and keeps typed input', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  const [force, acceleration] = ['#force-limit-force_n', '#acceleration-acceleration_mm_s2'];
  const shows = (selector, value) =>
    page.waitForFunction(([field, wanted]) => document.querySelector(field)?.value === wanted, [selector, value]);
  await shows(force, '40');
  await page.fill(force, '33');
  await served.ask('PUT', 'grippers/left/settings/force-limit', { force_n: 44 });
  await served.ask('PUT', 'grippers/left/settings/acceleration', { acceleration_mm_s2: 1500 });
  await shows(acceleration, '1500');
  await page.waitForSelector('.meanwhile:has-text("44 N")');
  await page.fill(acceleration, '1600');
  await page.locator(`form:has(${acceleration}) button[type=submit]`).click();
  await page.waitForSelector('.settings-panel:has-text("Applied.")');
  assert.match(await page.locator('.meanwhile').innerText(), /by http:/, 'another setting leaves this note alone');
  assert.equal(await page.inputValue(force), '33');
  await page.click('.meanwhile button');
  await shows(force, '44');
  assert.equal(await page.locator('.meanwhile').count(), 0);
  await page.fill(force, '30');
  await page.locator(`form:has(${force}) button[type=submit]`).click();
  await page.waitForSelector('.settings-panel:has-text("Applied.")');
  assert.equal((await served.ask('GET', 'grippers/left/settings/force-limit')).force_n, 30);
  assert.equal(await page.locator('.meanwhile').count(), 0, 'the user’s own change is not reported');
  // The force hint shows the limit for a grip without a force, also after a grip changed it.
  await page.click('[data-view=operate]');
  await page.fill('#force', '');
  await page.waitForSelector('#force-hint:has-text("30 N")');
  await homed(page);
  await page.fill('#force', '25');
  await page.click('#grip:enabled');
  await page.waitForSelector('.last[data-outcome=PART_HELD]');
  await page.fill('#force', '');
  await page.waitForSelector('#force-hint:has-text("25 N")');
  assertClean(visitor);
});

test('a force limit lowered by overdrive is shown without an event', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { path: '/#/left/device' });
  const force = '#force-limit-force_n';
  const shows = (value) =>
    page.waitForFunction(([field, wanted]) => document.querySelector(field)?.value === wanted, [force, value]);
  await shows('40');
  await served.ask('PUT', 'grippers/left/settings/overdrive', { enabled: true });
  await served.ask('PUT', 'grippers/left/settings/force-limit', { force_n: 100 });
  await shows('100');
  await page.fill(force, '33');
  await served.ask('PUT', 'grippers/left/settings/overdrive', { enabled: false });
  await page.waitForSelector('.meanwhile:has-text("Meanwhile set to 80 N by –.")');
  await page.click('.meanwhile button');
  await shows('80');
});

test('a late answer does not overwrite that of a newer filter', async () => {
  const served = await gateway();
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 50, speed_mm_s: 300 });
  const { page } = await visit(launched, served, { path: '/#/left/history' });
  await altered(page, ...LATE_ANSWERS);
  await page.waitForSelector('tbody tr:nth-child(2)');
  let letGo;
  const held = new Promise((resolve) => {
    letGo = resolve;
  });
  await page.route('**/grips?**kind=move**', async (route) => {
    const response = await route.fetch();
    await held;
    await route.fulfill({ response });
  });
  const asked = page.waitForRequest('**/grips?**kind=move**');
  await page.selectOption('#kind', 'move');
  const late = await asked;
  const looks = [];
  page.on('requestfinished', (request) => {
    if (request.url().includes('/grips?')) looks.push(request.url());
  });
  await page.selectOption('#kind', 'home');
  const only = (word) =>
    page.waitForFunction((wanted) => {
      const rows = [...document.querySelectorAll('tbody tr')];
      return rows.length === 1 && rows[0].innerText.includes(wanted);
    }, word);
  await only('Home');
  await served.ask('PUT', 'grippers/left/settings/acceleration', { acceleration_mm_s2: 900 });
  await until('the event causes a reload', () => looks.length >= 2);
  await only('Home');
  letGo();
  await (await late.response()).finished();
  await rendered(page);
  await only('Home');
});

test('the first screen works without the other modules, and STOP too', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await page.route('**/later.js', (route) => route.abort());
  await page.goto(served.url);
  await page.waitForSelector('.missing [role=alert]:has-text("could not be loaded")');
  await page.waitForSelector('.figure-main');
  assert.equal(await page.locator('.motion-panel').count(), 0);
  await page.click('#stop');
  await page.waitForSelector('.stopped:has-text("confirmed")');
  await page.unroute('**/later.js');
  await page.click('.missing button');
  await page.waitForSelector('.latch');
  assert.equal(await page.locator('.missing').count(), 0);
});

test('a name that is typed before the page is complete is kept', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  let deliver;
  const typed = new Promise((resolve) => {
    deliver = resolve;
  });
  await page.route('**/later.js', async (route) => {
    await typed;
    await route.fallback();
  });
  await page.goto(served.url, { waitUntil: 'commit' });
  await page.fill('#my-name', 'Anna');
  deliver();
  await page.waitForSelector('.motion-panel');
  // A change of the footer that leaves the focus in the field.
  await page.evaluate(() => document.querySelector('[data-choice=theme-dark]').click());
  await page.waitForSelector('[data-choice=theme-dark][aria-pressed=true]');
  assert.equal(await page.inputValue('#my-name'), 'Anna');
  await page.press('#my-name', 'Tab');
  await controlled(page);
  assert.equal((await served.ask('GET', 'grippers/left/state')).lease_holder, 'Anna');
  assertClean(visitor);
});

test('updates before the page is ready are kept, from one subscription', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { hasOwnTimes: true });
  const { page } = visitor;
  const [asked, heard] = [[], []];
  await page.routeWebSocket('**/api/v1/ws', (socket) => {
    const server = socket.connectToServer();
    socket.onMessage((message) => {
      asked.push(JSON.parse(message).method);
      server.send(message);
    });
    server.onMessage((message) => {
      heard.push(JSON.parse(message));
      socket.send(message);
    });
  });
  let letGo;
  const held = new Promise((resolve) => {
    letGo = resolve;
  });
  await page.route('**/app.js', async (route) => {
    await held;
    await route.fallback();
  });
  await page.goto(served.url, { waitUntil: 'commit' });
  await until('the page has subscribed', () => asked.length === 1);
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/move', { width_mm: 50, speed_mm_s: 300 });
  await until('the end of the move is notified', () =>
    heard.some(({ params }) => params?.command === 'move' && params.outcome === 'SUCCESS'),
  );
  assert.deepEqual(asked, ['subscribe']);
  letGo();
  await page.waitForSelector('.last[data-outcome=SUCCESS]:has-text("Move")');
  await page.waitForSelector('.figure-main:has-text("50.00")');
  assert.equal(asked.filter((method) => method === 'subscribe').length, 1);
  assert.equal(await page.locator('.alarm').count(), 0, 'no alarm for silence');
  assertClean(visitor);
});

test('a failed first connection is retried', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  const connections = [];
  await page.routeWebSocket('**/api/v1/ws', async (socket) => {
    connections.push(socket);
    if (connections.length > 1) {
      socket.connectToServer();
      return;
    }
    await page.waitForSelector('.bar');
    await socket.close({ code: 1011 });
  });
  await page.goto(served.url);
  await page.waitForSelector('.figure-main');
  assert.equal(connections.length, 2);
  assertClean(visitor);
});

test('charts follow the colour scheme', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { colorScheme: 'light' });
  await homed(page);
  /** Darkest and lightest pixel of the chart: on a dark page the trace is the lightest, on a light page the grid. */
  const trace = () =>
    page.evaluate(() => {
      const canvas = document.querySelector('.chart canvas');
      if (!canvas || canvas.width === 0) return null;
      const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
      let [dark, light] = [255, 0];
      for (let at = 0; at < data.length; at += 4) {
        if (data[at + 3] < 250) continue;
        dark = Math.min(dark, data[at]);
        light = Math.max(light, data[at]);
      }
      return { dark, light };
    });
  // --trace is #24364a on the light page, and #c3d4e6 on the dark one.
  await until('the trace is dark', async () => ((await trace())?.dark ?? 255) < 0x40);
  await page.emulateMedia({ colorScheme: 'dark' });
  await until('the trace is light', async () => {
    const { light, dark } = await trace();
    return light >= 0xa9 && dark >= 0x28;
  });
});

test('a theme that is chosen in another tab is followed', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { colorScheme: 'light' });
  const { page, context } = visitor;
  await page.waitForSelector('#take-control');
  const other = await context.newPage();
  await other.goto(served.url);
  await other.click('[data-choice=theme-dark]');
  await page.waitForSelector('html[data-theme=dark]');
  await page.waitForSelector('[data-choice=theme-dark][aria-pressed=true]');
  assertClean(visitor);
});

test('texts are cut like in the gateway, and ambiguous numbers are not sent', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  await homed(page);
  await page.fill('#part', 'ä'.repeat(40));
  assert.equal(await page.inputValue('#part'), 'ä'.repeat(24));
  await named(page, 'あ'.repeat(20));
  assert.equal(await page.inputValue('#my-name'), 'あ'.repeat(10));
  await page.click('#give-back');
  await page.waitForSelector('html:not([data-pressed]) #take-control');
  await page.click('#take-control');
  await page.waitForSelector(`.take:has-text("${'あ'.repeat(10)}")`);
  await page.fill('#speed', '100');
  await page.fill('#width', '1,000');
  assert.match(await page.locator('#width-hint').innerText(), /1,000 can be read as 1 or as 1000/);
  assert.ok(await page.locator('#move').isDisabled());
  await page.fill('#width', '20');
  await page.click('#grip:enabled');
  await page.waitForSelector('.last[data-outcome=PART_HELD]');
  const { events } = await served.ask('GET', 'events?gripper=left&kind=command');
  assert.equal(events.find(({ command, phase }) => command === 'grip' && phase === 'admitted').part_id, 'ä'.repeat(24));
  assert.deepEqual((await served.ask('GET', 'events?kind=refused')).events, []);
  assertClean(visitor);
});

test('a problem with missing values is shown in the gateway’s words', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  await page.waitForSelector('#take-control');
  const said = (problem) => page.evaluate(`ofProblem(${JSON.stringify(problem)})`);
  assert.equal(await said({ code: 'lease_held', holder: 'Anna', detail: 'held' }), 'Anna has control.');
  assert.equal(await said({ code: 'malformed', detail: 'expected a comma at line 1' }), 'expected a comma at line 1');
  assert.equal(await said({ code: 'out_of_range', field: 'width_mm', value: 0, min: 0, detail: 'beyond' }), 'beyond');
  assert.equal(await said({ code: 'a_new_one' }), 'a_new_one');
});

test('the log is covered while the gateway is silent', async () => {
  const served = await gateway();
  const { page, allowed } = await visit(launched, served, { path: '/#/left/log', hasOwnTimes: true });
  await page.click('#with-updates');
  await page.waitForSelector('.frame');
  served.child.kill('SIGSTOP');
  try {
    await page.waitForSelector('.covered:has(.frames) .cover:has-text("is not responding")');
  } finally {
    allowed.connections = true;
    served.child.kill('SIGCONT');
  }
  await page.waitForFunction(() => !document.querySelector('.cover'));
});
