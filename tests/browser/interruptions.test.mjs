// Control and commands across a change of view, forced control, a lost connection and a second tab.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import {
  altered,
  assertClean,
  browser,
  controlled,
  gateway,
  homed,
  named,
  LATE_ANSWERS,
  rendered,
  simulator,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

/**
 * Filters the messages between a page and the gateway, from the page's next load on. `toPage` gets a message, which it
 * can change, a function that passes the original on, and the request that it answers, if any. `onOpen` gets each
 * connection of the page.
 */
function filtered(page, { toPage = () => true, toGateway = () => true, onOpen = () => {} }) {
  return page.routeWebSocket('**/api/v1/ws', (socket) => {
    onOpen(socket);
    const server = socket.connectToServer();
    const requests = new Map();
    socket.onMessage((message) => {
      const request = JSON.parse(message);
      requests.set(request.id, request);
      if (toGateway(request)) server.send(message);
    });
    server.onMessage((message) => {
      const parsed = JSON.parse(message);
      const request = requests.get(parsed.id);
      if (toPage(parsed, () => socket.send(message), request)) socket.send(JSON.stringify(parsed));
    });
  });
}

test('handed-over control is taken from any view', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await named(ben.page, 'Ben');
  await controlled(anna.page);
  await ben.page.click('#ask-control');
  await ben.page.waitForSelector('.take:has-text("Control requested.")');
  await ben.page.click('[data-view=history]');
  await ben.page.waitForSelector('#export');
  await anna.page.click('.strip:not([data-fresh]) #hand-over');
  await ben.page.waitForSelector('.status.tone-mine');
  const { events } = await served.ask('GET', 'events?kind=lease&order=oldest');
  assert.equal(events.at(-1).event, 'handed_over');
  [anna, ben].forEach(assertClean);
});

test('control handed over at once is taken too', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  // Ben's page gets no answer about the lease before the hand-over.
  await filtered(ben.page, { toPage: (_message, _pass, request) => request?.method !== 'lease' });
  await ben.page.reload();
  await controlled(anna.page);
  await ben.page.click('#ask-control');
  await anna.page.click('.strip:not([data-fresh]) #hand-over');
  await ben.page.waitForSelector('.status.tone-mine');
});

test('only the first request for control is confirmed', async () => {
  const served = await gateway();
  const [anna, ben, cleo] = [
    await visit(launched, served),
    await visit(launched, served),
    await visit(launched, served),
  ];
  await named(ben.page, 'Ben');
  await controlled(anna.page);
  await ben.page.click('#ask-control');
  await ben.page.waitForSelector('.take:has-text("Control requested.")');
  await cleo.page.click('#ask-control');
  await cleo.page.waitForSelector('.problem:has-text("Ben asked for control first")');
  assert.equal(await cleo.page.locator('.take:has-text("Control requested.")').count(), 0);
});

test('control is taken by the second that asked, and by a page that was renamed meanwhile', async () => {
  const served = await gateway();
  const [anna, ben, cleo] = [
    await visit(launched, served),
    await visit(launched, served),
    await visit(launched, served),
  ];
  for (const [{ page }, name] of [
    [ben, 'Ben'],
    [cleo, 'Cleo'],
  ])
    await named(page, name);
  await controlled(anna.page);
  await ben.page.click('#ask-control');
  await ben.page.waitForSelector('.take:has-text("Control requested.")');
  await cleo.page.click('#ask-control');
  await cleo.page.waitForSelector('.problem:has-text("Ben asked for control first")');
  await named(ben.page, 'Benjamin');
  await anna.page.click('.strip:not([data-fresh]) #hand-over');
  await ben.page.waitForSelector('.status.tone-mine');
  await ben.page.click('.strip:not([data-fresh]) #hand-over');
  await cleo.page.waitForSelector('.status.tone-mine');
  const { holder, requested_by: asks } = await served.ask('GET', 'grippers/left/lease');
  assert.deepEqual([holder, asks], ['Cleo', null]);
});

test('a request for control is repeated, and the holder notices its end', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await named(ben.page, 'Ben');
  let requests = 0;
  let hasEnded = false;
  await filtered(anna.page, {
    // As if the request had not been repeated for 60 s.
    toPage: (message, _pass, request) => {
      if (hasEnded && request?.method === 'lease') message.result.requested_by = null;
      return true;
    },
  });
  await filtered(ben.page, {
    toGateway: ({ method, params }) => {
      if (method === 'lease.take' && params.request) requests += 1;
      return true;
    },
  });
  for (const { page } of [anna, ben]) {
    await altered(page, ['REPEATED_EVERY_MS = 20_000', 'REPEATED_EVERY_MS = 200']);
  }
  await controlled(anna.page);
  await ben.page.click('#ask-control');
  await anna.page.waitForSelector('[data-notice=asked]');
  await until('the request is repeated', () => requests >= 3);
  assert.equal(await ben.page.locator('.problem').count(), 0);
  const { events } = await served.ask('GET', 'events?kind=lease');
  assert.equal(events.filter(({ event }) => event === 'requested').length, 1);
  hasEnded = true;
  await anna.page.waitForSelector('[data-notice=asked]', { state: 'detached' });
});

test('a late answer about the lease does not hide a request for control', async () => {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await named(ben.page, 'Ben');
  let isTaken = false;
  let late = null;
  let passLate = null;
  await filtered(anna.page, {
    toGateway: (request) => {
      if (request.method === 'lease' && isTaken) late ??= request;
      return true;
    },
    toPage: ({ method, params }, pass, request) => {
      isTaken ||= method === 'event' && params.event === 'taken';
      if (request !== late) return true;
      passLate = pass;
      return false;
    },
  });
  await altered(anna.page, ...LATE_ANSWERS);
  await controlled(anna.page);
  await until('the lease is answered', () => passLate);
  await ben.page.click('#ask-control');
  const notice = '[data-notice=asked]:has-text("Ben is asking for control of left")';
  await anna.page.waitForSelector(notice);
  passLate();
  await anna.page.evaluate(() => new Promise(requestAnimationFrame));
  await anna.page.evaluate(() => new Promise(requestAnimationFrame));
  assert.equal(await anna.page.locator(notice).count(), 1);
});

test('a late answer about a setting does not replace the value that another client has set meanwhile', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50'] });
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  const passLate = [];
  await filtered(page, {
    toPage: (_message, pass, request) => {
      if (request?.method !== 'settings.device-tag') return true;
      passLate.push(pass);
      return false;
    },
  });
  await altered(page, ...LATE_ANSWERS);
  await until('the tag is answered', () => passLate.length > 0);
  const set = (setting, value) => served.ask('PUT', `grippers/left/settings/${setting}`, value);
  const shows = (field, text) => until(`${field} shows ${text}`, async () => (await page.inputValue(field)) === text);
  await set('device-tag', { tag: 'cell 7' });
  await shows('#tag', 'cell 7');
  passLate.forEach((pass) => pass());
  // The page takes messages in their order.
  await set('acceleration', { acceleration_mm_s2: 700 });
  await shows('#acceleration-acceleration_mm_s2', '700');
  assert.equal(await page.inputValue('#tag'), 'cell 7');
  assertClean(visitor);
});

test('a recipe that is changed during the first reading is shown', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  let passFirst = null;
  let isChanged = false;
  await filtered(page, {
    toPage: ({ method, params }, pass, request) => {
      isChanged ||= method === 'event' && params.kind === 'recipe';
      if (request?.method !== 'recipes' || passFirst) return true;
      passFirst = pass;
      return false;
    },
  });
  await altered(page, ...LATE_ANSWERS);
  await until('the recipes are answered', () => passFirst);
  await served.ask('PUT', 'recipes/ring', { number: 3, width_mm: 20, speed_mm_s: 200 });
  await until('the change is reported', () => isChanged);
  passFirst();
  await page.waitForSelector('.recipe[data-recipe="3"]');
  assertClean(visitor);
});

test('what missed events would have reported is read after a gap', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  let isGap = false;
  await filtered(page, {
    toPage: (message) => {
      if (!['event', 'grip', 'gap'].includes(message.method)) return true;
      message.method = 'gap';
      return isGap;
    },
  });
  await page.reload();
  const acceleration = '#acceleration-acceleration_mm_s2';
  await until('the acceleration is shown', async () => (await page.inputValue(acceleration)) !== '');
  await page.waitForSelector('.panel:has(#statistics-title) dd:text-is("0")');
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/grip', { width_mm: 20, speed_mm_s: 200 });
  await served.ask('POST', 'grippers/left/release', { width_mm: 40, speed_mm_s: 200 });
  await served.ask('PUT', 'grippers/left/settings/acceleration', { acceleration_mm_s2: 700 });
  isGap = true;
  await served.ask('PUT', 'recipes/ring', { number: 3, width_mm: 20, speed_mm_s: 200 });
  await until('the acceleration is read', async () => (await page.inputValue(acceleration)) === '700');
  await page.waitForSelector('.panel:has(#statistics-title) dd:text-is("1")');
  assertClean(visitor);
});

test('grips are counted on the page even if no shown state reports them', async () => {
  const served = await gateway({ more: ['--gripper', 'left=sim://wsg50?part_mm=20'] });
  const visitor = await visit(launched, served, { path: '/#/left/device' });
  const { page } = visitor;
  await filtered(page, {
    // As if each motion ended between two updates of the screen.
    toPage: ({ method, params, result }, _pass, request) => {
      const state = method === 'state' ? params : request?.method === 'state' ? result : null;
      if (state) state.command = null;
      return true;
    },
  });
  await page.reload();
  const put = (path, value) => served.ask('PUT', `grippers/left/${path}`, value);
  const set = '.panel:has(#finger-set-title)';
  await served.ask('POST', 'grippers/left/home');
  await put('finger-set', { id: 'F-12', maintenance_cycles: 9 });
  await page.waitForSelector(`${set} dd:has-text("0 / 9")`);
  for (const count of [1, 2]) {
    await served.ask('POST', 'grippers/left/grip', { width_mm: 20, speed_mm_s: 200 });
    await served.ask('POST', 'grippers/left/release', { width_mm: 40, speed_mm_s: 200 });
    await page.waitForSelector(`${set} dd:has-text("${count} / 9")`);
    await page.waitForSelector(`.panel:has(#statistics-title) dd:text-is("${count}")`);
  }
  assertClean(visitor);
});

test('releasing a jog after a forced take does not stop the new holder', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served);
  let isAnswered = false;
  await filtered(page, {
    toPage: (_message, pass, request) => {
      pass();
      isAnswered ||= request?.method === 'move';
      return false;
    },
  });
  await page.reload();
  await homed(page);
  await page.locator('#jog-close').hover();
  const state = () => served.ask('GET', 'grippers/left/state');
  const from = (await state()).width_mm;
  await page.mouse.down();
  await until('the jog moves the fingers', async () => (await state()).width_mm < from - 1);
  // Until the page knows the id of its command, it stops any motion.
  await until('the jog is answered', () => isAnswered);
  await page.evaluate(() => {});
  const { token } = await served.ask('POST', 'grippers/left/lease', { holder: 'robot', ttl_ms: 60_000, force: true });
  const runs = await until('the robot moves the fingers', async () => {
    const { id } = await served.ask('POST', 'grippers/left/move?wait_ms=0', {
      width_mm: 60,
      speed_mm_s: 20,
      lease: token,
    });
    return id;
  });
  await page.mouse.up();
  await page.waitForSelector('.status:has-text("robot")');
  assert.equal((await served.ask('GET', `grippers/left/commands/${runs}?wait_ms=20000`)).outcome, 'SUCCESS');
});

test('releasing a jog stops it even if its answer was lost', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const { page } = await visit(launched, served);
  await homed(page);
  await page.fill('#speed', '5');
  await page.locator('#jog-close').hover();
  await device.happens({ fault: { kind: 'corrupt_checksum', id: 0x21, times: 1 } });
  await page.mouse.down();
  const state = () => served.ask('GET', 'grippers/left/state');
  await until('the command ended as UNKNOWN', async () => {
    const { events } = await served.ask('GET', 'events?kind=command&outcome=UNKNOWN');
    return events.length > 0;
  });
  // The gateway sends a Stop of its own too, so the fingers can stand already.
  await page.mouse.up();
  await until('the fingers stand', async () => (await state()).moving === false);
  assert.ok((await state()).width_mm > 5, 'stopped on its way');
});

/** Starts a jog by Anna, whose messages are filtered and whose page is changed, with a request for control by Ben. */
async function jogging(filters, ...changes) {
  const served = await gateway();
  const [anna, ben] = [await visit(launched, served), await visit(launched, served)];
  await filtered(anna.page, filters);
  await altered(anna.page, ...changes);
  await homed(anna.page);
  await ben.page.click('#ask-control');
  await anna.page.fill('#speed', '5');
  await anna.page.waitForSelector('#hand-over');
  await rendered(anna.page);
  const state = () => served.ask('GET', 'grippers/left/state');
  const from = (await state()).width_mm;
  await anna.page.locator('#jog-close').hover();
  await anna.page.mouse.down();
  await until('the jog moves the fingers', async () => (await state()).width_mm < from - 1);
  // With another finger.
  await anna.page.evaluate(() => document.querySelector('#hand-over').click());
  await ben.page.waitForSelector('.status.tone-mine');
  await anna.page.waitForSelector('.status.tone-mine', { state: 'detached' });
  const stopped = () =>
    until('the jog is aborted', async () => {
      const { events } = await served.ask('GET', 'events?kind=command&outcome=ABORTED');
      return events.length > 0 && (await state()).moving === false;
    });
  return { state, stopped, page: anna.page };
}

test('the cancel of a handed-over jog is repeated', async () => {
  let lost = 0;
  const toGateway = ({ method }) => {
    if (method !== 'cancel' || lost === 2) return true;
    lost += 1;
    return false;
  };
  const { stopped, page } = await jogging({ toGateway });
  await page.mouse.up();
  await stopped();
  assert.equal(lost, 2);
});

test('a handed-over jog is cancelled as soon as its id is known', async () => {
  let named = null;
  const toPage = (_message, pass, request) => {
    if (request?.method !== 'move' || request.params.speed_mm_s !== 5) return true;
    named = pass;
    return false;
  };
  const { state, stopped, page } = await jogging({ toPage }, ...LATE_ANSWERS);
  await page.mouse.up();
  assert.equal((await state()).moving, true);
  named();
  await stopped();
});

/** A page whose clock is paused, and whose messages from the gateway can be kept back. */
async function paused() {
  const served = await gateway();
  const { page } = await visit(launched, served, { hasOwnTimes: true });
  const line = { isSilent: false, passed: 0, subscribed: 0, socket: null };
  await filtered(page, {
    onOpen: (socket) => {
      line.socket = socket;
    },
    toGateway: ({ method }) => {
      line.subscribed += method === 'subscribe' ? 1 : 0;
      return true;
    },
    toPage: () => {
      line.passed += line.isSilent ? 0 : 1;
      return !line.isSilent;
    },
  });
  await page.clock.install();
  await page.reload();
  await page.waitForSelector('#take-control');
  await page.waitForSelector('.alarms-panel');
  await page.clock.pauseAt(Date.now() + 10_000);
  const shows = async (selector) => (await page.locator(selector).count()) > 0;
  /** Lets the page's time pass until the selector matches. Returns the milliseconds. */
  const passes = async (selector) => {
    let ms = 0;
    await until(selector, async () => {
      if (await shows(selector)) return true;
      await page.clock.runFor(200);
      ms += 200;
      return false;
    });
    return ms;
  };
  /** Lets messages pass until the page is live. */
  const live = async () => {
    line.isSilent = false;
    await until('the page is live', async () => {
      const { passed } = line;
      await until('messages pass', () => line.passed > passed);
      await page.clock.runFor(200);
      return !(await shows('.jaws-panel .cover'));
    });
  };
  await live();
  return { page, line, shows, passes, live };
}

test('a short silence is shown, a longer one is an alarm', async () => {
  const { line, shows, passes, live } = await paused();
  line.isSilent = true;
  assert.ok((await passes('.jaws-panel .cover:has-text("The gateway is not responding")')) < 2000);
  assert.ok(await shows('.alarm-badge:has-text("Alarms: unknown")'));
  assert.ok(await shows('.alarms-panel:has-text("Alarms: unknown")'));
  await live();
  assert.ok(await shows('.alarm-badge:has-text("No alarms")'));
  line.isSilent = true;
  const alarmedAfterMs = await passes('.alarm:has-text("No connection to the gateway")');
  assert.ok(alarmedAfterMs < 3000, `${alarmedAfterMs} ms`);
  assert.ok(await shows('.jaws-panel .cover:has-text("The gateway is not responding")'), 'still the same connection');
});

test('a page that was busy keeps its connection', async () => {
  const { page, line, live } = await paused();
  const { subscribed } = line;
  // Timers that are overdue run once.
  await page.clock.fastForward(6000);
  await live();
  assert.equal(line.subscribed, subscribed);
});

test('a new connection without messages is still lost', async () => {
  const { page, line, shows, passes, live } = await paused();
  const lost = '.jaws-panel .cover:has-text("No connection to the gateway")';
  const { subscribed, socket } = line;
  line.isSilent = true;
  await socket.close();
  assert.ok((await passes(lost)) < 1000);
  assert.ok(await shows('.alarm:has-text("No connection to the gateway")'));
  let looksAfter = 0;
  await until('the page has looked after it had reconnected', async () => {
    await page.clock.runFor(200);
    assert.ok(await shows(lost));
    looksAfter += line.subscribed > subscribed ? 1 : 0;
    return looksAfter > 5;
  });
  await live();
  assert.ok(await shows('.alarm:has-text("cleared")'));
});

test('a short silence loses nothing that a person has typed or opened', async () => {
  const served = await gateway();
  const { page } = await visit(launched, served, { path: '/#/left/history', hasOwnTimes: true });
  let isSilent = false;
  await filtered(page, { toPage: () => !isSilent });
  await page.reload();
  const silence = async () => {
    isSilent = true;
    await page.waitForSelector('.covered');
    isSilent = false;
    await page.waitForSelector('.covered', { state: 'detached' });
  };
  await served.ask('POST', 'grippers/left/home');
  await served.ask('POST', 'grippers/left/grip', { width_mm: 20, speed_mm_s: 300, part_id: 'lot-1' });
  await page.waitForSelector('tbody tr:has-text("lot-1")');
  await page.click('#evaluate');
  await page.click('.numbers button:has-text("lot-1")');
  await page.waitForSelector('.part-report');
  await silence();
  assert.equal(await page.locator('.numbers').count(), 1);
  assert.equal(await page.locator('.part-report').count(), 1);
  const change = (acceleration_mm_s2) =>
    served.ask('PUT', 'grippers/left/settings/acceleration', { acceleration_mm_s2 });
  for (let count = 0; count < 60; count += 1) await change(500 + count);
  await page.click('[data-choice=records-events]');
  await page.click('#older');
  await page.waitForFunction(() => document.querySelectorAll('tbody tr').length > 60);
  let reloads = 0;
  page.on('request', (request) => {
    if (request.url().includes('/events?')) reloads += 1;
  });
  await silence();
  const changes = () => page.evaluate('journalChanges.peek()');
  const before = await changes();
  await change(600);
  await until('the page knows of the change', async () => (await changes()) > before);
  await rendered(page);
  assert.equal(reloads, 0);
  assert.ok((await page.locator('tbody tr').count()) > 60, 'older pages stay');
  await page.click('[data-view=device]');
  await page.fill('#force-limit-force_n', '44');
  await silence();
  assert.equal(await page.inputValue('#force-limit-force_n'), '44');
});

test('a command lost with the gateway is not shown as running', async () => {
  const first = await gateway();
  const { page, allowed } = await visit(launched, first);
  await homed(page);
  await page.fill('#width', '5');
  await page.fill('#speed', '5');
  await page.click('#move');
  await page.waitForSelector('.last[data-outcome=running]');
  await page.waitForSelector('.jaws .target');
  allowed.connections = true;
  await first.kill('SIGKILL');
  await page.waitForSelector('.cover');
  const second = await gateway({ port: first.port });
  await second.ask('POST', 'grippers/left/home');
  await page.waitForFunction(() => !document.querySelector('.cover'));
  await page.waitForSelector('.last[data-outcome]:not([data-outcome=running])');
  assert.equal(await page.locator('.jaws .target').count(), 0);
  assert.doesNotMatch(await page.locator('.jaws-words').innerText(), /target/);
});

test('two tabs are two clients', async () => {
  const served = await gateway();
  const one = await visit(launched, served);
  const name = (page) => page.inputValue('#my-name');
  await one.page.waitForSelector('#my-name');
  const first = await name(one.page);
  const other = await one.context.newPage();
  await other.goto(served.url);
  await other.waitForFunction((taken) => document.querySelector('#my-name')?.value === `${taken} (2)`, first);
  assert.equal(await name(one.page), first, 'the first tab keeps the name');
  await named(other, first);
  await other.waitForFunction((taken) => document.querySelector('#my-name').value === `${taken} (2)`, first);
  await other.reload();
  await other.waitForSelector('#take-control');
  assert.equal(await name(other), `${first} (2)`, 'a tab keeps its name');
  assertClean(one);
});
