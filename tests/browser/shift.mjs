// A shift at a panel: eight grippers move, and two other clients work too. Nothing shown may be old, and no memory may
// leak. SECONDS_OF_SHIFT sets the duration, an hour by default. Only `tests/run --long` runs it.

import assert from 'node:assert/strict';
import { after, test } from 'node:test';

import { bareBrowser } from './bare.mjs';
import { endAll, gateway, until } from './harness.mjs';
import { cpuSeconds, heapBytes, keepMoving, percent, sleep } from './measure.mjs';

after(endAll);

const SECONDS = Number(process.env.SECONDS_OF_SHIFT ?? 3600);
const NAMES = Array.from({ length: 8 }, (_, index) => `g${index + 1}`);

/** Time within which the page must show a change, on a busy machine too. */
const SHOWN_WITHIN_MS = 5000;
/** Time in each of the other views, and in the view to operate, in every round. */
const LOOKS_MS = 3000;
const OPERATES_MS = 30_000;

const MOST_CPU = 0.13;
const MOST_GROWTH_BYTES = 1_000_000;
const MOST_NODES = 500;

/** The charts fill their windows in ten minutes. Growth counts from then on. */
const WARM_UP_MS = 620_000;

const click = (page, selector) =>
  page.evaluate(`(() => {
    const found = document.querySelector(${JSON.stringify(selector)});
    found?.click();
    return found !== null && !found.disabled;
  })()`);

const clickOnce = (page, selector) => until(`click on ${selector}`, () => click(page, selector));

const text = (page, selector) => page.evaluate(`document.querySelector(${JSON.stringify(selector)})?.innerText ?? ''`);

const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

test(`nothing is old and nothing leaks in a shift of ${SECONDS} s`, async () => {
  const more = NAMES.flatMap((name) => ['--gripper', `${name}=sim://wsg50`]);
  const served = await gateway({ more });
  const post = (path, body) => served.ask('POST', path, body);
  const movers = NAMES.map((name) => keepMoving(served, name));
  // Another browser has processes of its own, so that it does not count.
  const [launched, elsewhere] = await Promise.all([bareBrowser(), bareBrowser()]);
  const page = await launched.open(`${served.url}/#/g1/operate`);
  const ben = await elsewhere.open(`${served.url}/#/g1/operate`);
  for (const one of [page, ben])
    await until('all grippers are shown', () => one.evaluate(`document.querySelectorAll('.chip').length`));
  await ben.evaluate(`(() => {
    const field = document.querySelector('#my-name');
    field.value = 'Ben';
    field.dispatchEvent(new Event('change', { bubbles: true }));
  })()`);

  let slowest = 0;
  /** Waits until the page shows something, and notes how long that took. */
  const shows = async (what, look) => {
    const begin = performance.now();
    await until(what, look);
    slowest = Math.max(slowest, performance.now() - begin);
  };
  const statuses = () => text(page, '.statuses');

  const work = async () => {
    movers[0].rest();
    await until('g1 rests', async () => {
      const { moving, command } = await served.ask('GET', 'grippers/g1/state');
      return !moving && command === null;
    });
    const { width_mm: width } = await served.ask('GET', 'grippers/g1/state');
    await shows('the width', async () => (await text(page, '.figure-main .figure-value')).startsWith(width.toFixed(2)));
    await clickOnce(ben, '#take-control');
    await shows('who has control', async () => (await statuses()).includes('Ben'));
    await clickOnce(ben, '#give-back');
    await shows('that nobody has control', async () => (await statuses()).includes('nobody'));
    const { fast_stop_id: id } = await post('grippers/g8/fast-stop', { reason: 'light curtain' });
    // On a busy machine, a silent gateway can be another alarm.
    const isListed = async () => (await text(page, '.alarms-panel')).includes('g8: FAST STOP');
    await shows('the alarm', isListed);
    await until('the alarm is acknowledged', async () => {
      await post('grippers/g8/acknowledge', { fast_stop_id: id });
      return !(await served.ask('GET', 'grippers/g8/state')).fast_stop;
    });
    await shows('that the alarm is over', async () => !(await isListed()));
    movers[0].goOn();
  };

  const look = async () => {
    for (const view of ['history', 'log', 'device', 'all', 'operate']) {
      await clickOnce(page, `[data-view=${view}]`);
      await sleep(LOOKS_MS);
      assert.equal(await page.evaluate(`document.querySelectorAll('.cover').length`), 0, `values are covered: ${view}`);
    }
  };

  const begin = performance.now();
  const rounds = [];
  while (performance.now() - begin < SECONDS * 1000) {
    await look();
    await work();
    const before = await cpuSeconds(launched);
    const from = performance.now();
    await sleep(OPERATES_MS);
    const spent = Object.entries(await cpuSeconds(launched)).map(([type, one]) => one - (before[type] ?? 0));
    const cpu = spent.reduce((sum, one) => sum + one, 0) / ((performance.now() - from) / 1000);
    const heap = await heapBytes(page);
    const { nodes, jsEventListeners: listeners } = await page.ask('Memory.getDOMCounters');
    rounds.push({ at: performance.now() - begin, cpu, heap, nodes, listeners });
    const minutes = Math.round((performance.now() - begin) / 60_000);
    console.log(
      `${minutes} min: ${percent(cpu)} of one core, heap ${(heap / 1e6).toFixed(3)} MB, ${nodes} nodes, ${listeners} listeners, slowest ${Math.round(slowest)} ms`,
    );
  }
  await Promise.all(movers.map((mover) => mover.end()));
  const warm = rounds.filter(({ at }) => at > Math.min(WARM_UP_MS, SECONDS * 500));
  const few = Math.max(1, Math.min(5, Math.floor(warm.length / 2)));
  const growth = (key) =>
    median(warm.slice(-few).map((one) => one[key])) - median(warm.slice(0, few).map((one) => one[key]));
  const share = median(rounds.map(({ cpu }) => cpu));
  console.log(
    `${percent(share)} of one core in half of the rounds; growth since the warm-up: heap ${growth('heap')} bytes, ${growth('nodes')} nodes, ${growth('listeners')} listeners`,
  );
  assert.ok(slowest < SHOWN_WITHIN_MS, `a change was shown after ${Math.round(slowest)} ms`);
  assert.ok(growth('heap') < MOST_GROWTH_BYTES, `the heap has grown by ${growth('heap')} bytes`);
  assert.ok(growth('nodes') < MOST_NODES, `${growth('nodes')} nodes more`);
  assert.ok(share < MOST_CPU, `${percent(share)} of one core`);
});
