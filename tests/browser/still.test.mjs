// The layout over screen sizes, languages and states: nothing overlaps, is cut or broken, each control can be hit at its
// middle, and a notice moves nothing.

import assert from 'node:assert/strict';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { faults, places } from './checks.mjs';
import {
  assertClean,
  browser,
  controlled,
  gateway,
  homed,
  rendered,
  shoot,
  simulator,
  started,
  stopped,
  token,
  until,
  visit,
} from './harness.mjs';

const launched = await browser();

/** Widths and heights of screens, in CSS pixels. Zoom of 200 % halves them. */
const SIZES = [
  [320, 568],
  [360, 740],
  [390, 844],
  [768, 1024],
  [800, 1280],
  [1024, 768],
  [1280, 800],
  [1366, 768],
  [1440, 900],
  [1920, 1080],
  [2560, 1440],
];

/** Each in both orientations, and at a zoom of 150 and 200 % of the usual panel. */
const ALL_SIZES = [
  ...SIZES.flatMap(([width, height]) => [
    [width, height],
    [height, width],
  ]),
  [853, 533],
  [640, 400],
];

/** Sizes of the screenshots, for visual review. */
const SHOT = new Set(['390x844', '768x1024', '1024x768', '1366x768', '1920x1080']);

const LONG = ['longest_possible_name_of_gripper', 'second_longest_name_of_a_gripper'];
const LONG_HOLDER = 'operator_with_a_very_long_name_1';

const RECIPES = {
  'A-1047': { number: 1, width_mm: 20, speed_mm_s: 200, force_n: 30, release_width_mm: 40 },
  housing_lower_part_with_long_name: { number: 2, width_mm: 35, speed_mm_s: 100, release_width_mm: 60 },
  'Flansch-32': {
    number: 3,
    width_mm: 32,
    speed_mm_s: 150,
    force_n: 45,
    release_width_mm: 50,
    accept_min_mm: 31,
    accept_max_mm: 33,
  },
};

async function withRecipes(served) {
  for (const [part, recipe] of Object.entries(RECIPES)) await served.ask('PUT', `recipes/${part}`, recipe);
}

const grip = { width_mm: 20, speed_mm_s: 300 };

/** Holds a part without a lease. */
async function held(served, gripper = 'left') {
  await served.ask('POST', `grippers/${gripper}/home`);
  await served.ask('POST', `grippers/${gripper}/grip`, grip);
}

const cell = (names, part = 20) =>
  gateway({ more: names.flatMap((name) => ['--gripper', `${name}=sim://wsg50?part_mm=${part}`]) });

/** Shows a servo session with long figures for as long as the page is open. */
async function steered(page) {
  const servo = { by: 'ws:127.0.0.1', adapter: 'width_speed', hz: 100, applied_age_ms: 1234 };
  // Counts as an answer, so that no answer to an earlier request replaces it.
  await page.evaluate(`learnServo = () => {}; shownGripper.peek().asking('servo')(${JSON.stringify(servo)})`);
  await page.waitForSelector('.result-note:text-matches("1234 ms")');
}

/**
 * States of a page, each with its steps. They get a function that opens the page, and return it once the state is
 * shown.
 */
const STATES = {
  'not-referenced': async (open) => {
    const served = await cell(['left', 'right']);
    await withRecipes(served);
    const visitor = await open(served);
    await controlled(visitor.page);
    await visitor.page.waitForSelector('#home:enabled');
    return visitor;
  },
  free: async (open) => {
    const served = await cell(['left', 'right']);
    await withRecipes(served);
    const visitor = await open(served);
    await visitor.page.waitForSelector('#take-control');
    return visitor;
  },
  'first-use': async (open) => {
    const visitor = await open(await cell(['left']));
    await visitor.page.waitForSelector('#take-control');
    await visitor.page.waitForSelector('#width');
    return visitor;
  },
  holding: async (open) => {
    const served = await cell(['left', 'right']);
    await withRecipes(served);
    const visitor = await open(served);
    await homed(visitor.page);
    const { token } = await visitor.page.evaluate("find('left').held.peek()");
    await served.ask('POST', 'grippers/left/grip', { recipe: 1, lease: token });
    await visitor.page.waitForSelector('[data-result=HOLDING]');
    return visitor;
  },
  steered: async (open) => {
    const served = await cell(LONG);
    await withRecipes(served);
    await held(served, LONG[0]);
    await served.ask('POST', `grippers/${LONG[0]}/release`, { width_mm: 60, speed_mm_s: 300 });
    await served.ask('POST', `grippers/${LONG[0]}/lease`, { holder: LONG_HOLDER, ttl_ms: 60_000 });
    const visitor = await open(served);
    await visitor.page.waitForSelector('#ask-control');
    await steered(visitor.page);
    return visitor;
  },
  'steered-holding': async (open) => {
    const visitor = await STATES.holding(open);
    await steered(visitor.page);
    return visitor;
  },
  lost: async (open) => {
    const device = await simulator();
    const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
    await device.happens({ place_part: { width_mm: 20 } });
    await withRecipes(served);
    const visitor = await open(served);
    await homed(visitor.page);
    const { token } = await visitor.page.evaluate("find('left').held.peek()");
    await served.ask('POST', 'grippers/left/grip', { ...grip, lease: token });
    await device.happens('take_part');
    await visitor.page.waitForSelector('[data-result=PART_LOST]');
    return visitor;
  },
  'no-part': async (open) => {
    const served = await cell(['left', 'right'], 0);
    await withRecipes(served);
    const visitor = await open(served);
    await homed(visitor.page);
    const { token } = await visitor.page.evaluate("find('left').held.peek()");
    await served.ask('POST', 'grippers/left/grip', { ...grip, lease: token });
    await visitor.page.waitForSelector('[data-result=NO_PART]');
    return visitor;
  },
  reserved: async (open) => {
    const served = await cell(LONG);
    const [name] = LONG;
    await withRecipes(served);
    await held(served, name);
    await served.ask('POST', `grippers/${name}/lease`, { holder: LONG_HOLDER, ttl_ms: 100 });
    const visitor = await open(served);
    await visitor.page.waitForSelector('.status:has-text("operator_")');
    return visitor;
  },
  asked: async (open) => {
    const served = await cell(LONG);
    await withRecipes(served);
    const visitor = await open(served);
    await controlled(visitor.page);
    await served.ask('POST', `grippers/${LONG[0]}/lease`, { holder: LONG_HOLDER, request: true });
    await visitor.page.waitForSelector('[data-notice=asked]');
    return visitor;
  },
  stopped: async (open) => {
    const served = await cell(['left', 'right']);
    const visitor = await open(served);
    await controlled(visitor.page);
    await stopped(visitor.page);
    await visitor.page.waitForSelector('#acknowledge:enabled');
    return visitor;
  },
  'sign-in': async (open) => {
    const folder = mkdtempSync(join(tmpdir(), 'wsg-browser-'));
    started.push(() => rmSync(folder, { recursive: true }));
    const file = join(folder, 'tokens.json');
    const served = await gateway({ more: ['--tokens', file], secret: token(file, 'anna', 'operator') });
    const visitor = await open(served);
    await visitor.page.waitForSelector('.sign-in');
    return visitor;
  },
  'link-lost': async (open) => {
    const served = await gateway({ more: ['--gripper', 'left=tcp://127.0.0.1:9'], connects: [] });
    const visitor = await open(served);
    await visitor.page.waitForSelector('.jaws-panel .cover');
    await visitor.page.waitForSelector('.alarm');
    return visitor;
  },
  // These states of the link last for seconds at most.
  ...Object.fromEntries(
    ['unresponsive', 'reconnecting'].map((link) => [
      `link-${link}`,
      async (open) => {
        const visitor = await open(await cell(LONG), '/readyz');
        const { page } = visitor;
        await page.routeWebSocket('**/api/v1/ws', (socket) => {
          const server = socket.connectToServer();
          server.onMessage((message) => socket.send(message.replaceAll('"link":"connected"', `"link":"${link}"`)));
        });
        await page.goto(new URL('/', page.url()).href);
        await page.waitForSelector('.motion-panel .cover');
        return visitor;
      },
    ]),
  ),
  'gateway-lost': async (open) => {
    const served = await cell(['left', 'right']);
    const visitor = await open(served);
    await visitor.page.waitForSelector('#take-control');
    visitor.allowed.connections = true;
    await served.kill();
    await visitor.page.waitForSelector('.alarm');
    return visitor;
  },
  'three-alarms': async (open) => {
    const away = [
      'away_gripper_of_the_second_cell1',
      'away_gripper_of_the_second_cell2',
      'away_gripper_of_the_second_cell3',
    ];
    const more = [
      '--gripper',
      'left=sim://wsg50',
      ...away.flatMap((name, index) => ['--gripper', `${name}=tcp://127.0.0.1:${index + 9}`]),
    ];
    const served = await gateway({ more, connects: ['left'] });
    await withRecipes(served);
    const visitor = await open(served, '/#/left/operate');
    await visitor.page.waitForSelector('.alarm:nth-child(3)');
    return visitor;
  },
  many: async (open) => {
    const served = await cell(Array.from({ length: 24 }, (_, index) => `greifer_mit_langem_namen_hier_${index + 10}`));
    await withRecipes(served);
    const visitor = await open(served);
    await visitor.page.waitForSelector('#take-control');
    return visitor;
  },
};

/** Looks for faults at all sizes, in each language. Screenshots of the widths `isWholeShot` show the whole page. */
async function assertFits(page, name, { isWholeShot = () => false } = {}) {
  const found = [];
  for (const language of ['en', 'de']) {
    await page.click(`[data-choice=language-${language}]`);
    await page.waitForSelector(`html[lang=${language}]`);
    for (const [width, height] of ALL_SIZES) {
      const size = `${width}x${height}`;
      await page.setViewportSize({ width, height });
      await rendered(page);
      for (const fault of await faults(page)) found.push(`${size}, ${language}: ${fault}`);
      if (SHOT.has(size)) {
        await page.evaluate(() => scrollTo(0, 0));
        await shoot(page, `still-${name}-${size}-${language}`, { fullPage: isWholeShot(width) });
      }
    }
  }
  assert.equal(found.length, 0, `${found.length} faults:\n${found.join('\n')}`);
}

for (const [state, prepare] of Object.entries(STATES)) {
  test(`nothing overlaps, is cut or cannot be hit: ${state}`, async () => {
    const open = (served, path = '/') => visit(launched, served, { path, name: LONG_HOLDER, width: 1280, height: 800 });
    const { page } = await prepare(open);
    await assertFits(page, state, { isWholeShot: (width) => width < 720 });
  });
}

for (const view of ['history', 'log', 'device', 'all']) {
  test(`nothing overlaps, is cut or cannot be hit: view ${view}`, async () => {
    const served = await cell(LONG);
    await held(served, LONG[0]);
    const { page } = await visit(launched, served, { path: `/#/${LONG[0]}/${view}`, name: LONG_HOLDER });
    await page.waitForSelector('main h2');
    if (view === 'history') await page.waitForSelector('tbody tr:nth-child(2)');
    await assertFits(page, view);
  });
}

/** Changes of the notices, each with a selector of the result. */
const NOTICES = [
  [
    'a request for control',
    (served) => served.ask('POST', 'grippers/left/lease', { holder: 'Ben', request: true }),
    '[data-notice=asked]',
  ],
  [
    'the alarm of another gripper',
    (served) => served.ask('POST', 'grippers/right/fast-stop'),
    '.alarm-badge[class*=tone]',
  ],
  [
    'the loss of control',
    (served) => served.ask('POST', 'grippers/left/lease', { holder: 'Ben', force: true, ttl_ms: 60_000 }),
    '[data-notice=lost]',
  ],
];

for (const [width, height] of [
  [390, 844],
  [768, 1024],
  [1280, 800],
  [1920, 1080],
]) {
  test(`no control moves when a notice comes, ${width}x${height}`, async () => {
    const served = await cell(['left', 'right']);
    await withRecipes(served);
    const visitor = await visit(launched, served, { width, height });
    const { page } = visitor;
    await homed(page);
    await page.waitForSelector('.recipe');
    await page.waitForSelector('.alarms-panel');
    for (const [what, happens, selector] of NOTICES) {
      await page.evaluate(() => scrollTo(0, 0));
      await rendered(page);
      const before = await places(page);
      await happens(served);
      await page.waitForSelector(selector);
      await rendered(page);
      const after = await places(page);
      const moved = Object.keys(before).filter((key) => key in after && before[key] !== after[key]);
      assert.deepEqual(
        moved.map((key) => `${key}: ${before[key]} → ${after[key]}`),
        [],
        what,
      );
      assert.ok(Object.keys(before).length > 10, what);
    }
    await until('the page is still', async () => page.isVisible('#stop'));
    assertClean(visitor);
  });
}
