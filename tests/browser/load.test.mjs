// What an open page costs, with eight grippers that move all the time: figures of the browser's own processes and heap.
// SECONDS says for how long; `tests/run --long` takes a minute.

import assert from 'node:assert/strict';
import { after, test } from 'node:test';

import { assertClean, browser, endAll, gateway, visit } from './harness.mjs';

after(endAll);

const SECONDS = Number(process.env.SECONDS ?? 15);
const GRIPPERS = 8;

/** In shares of one core, all of the browser's processes together. */
const MOST_CPU = 0.10;
const MOST_FIRST_MS = 300;
/** What a heap may grow by and still not grow: charts fill their windows, and no two collections are the same. */
const MOST_GROWTH_BYTES = 1_000_000;

/** Moves it to and fro until it is told to end. */
function keepMoving({ ask }, name) {
  let goesOn = true;
  const done = (async () => {
    const post = (what, body) => ask('POST', `grippers/${name}/${what}`, body);
    await post('home', {});
    for (let turn = 0; goesOn; turn += 1) await post('move', { width_mm: turn % 2 ? 20 : 100, speed_mm_s: 60 });
  })();
  return async () => {
    goesOn = false;
    await done;
  };
}

async function cpuSeconds(session) {
  const { processInfo } = await session.send('SystemInfo.getProcessInfo');
  const byType = {};
  for (const { type, cpuTime } of processInfo) byType[type] = (byType[type] ?? 0) + cpuTime;
  return byType;
}

async function heapBytes(session) {
  // Twice: what finalizers let go of is there for the second.
  for (let count = 0; count < 2; count += 1) await session.send('HeapProfiler.collectGarbage');
  return (await session.send('Runtime.getHeapUsage')).usedSize;
}

async function metrics(session) {
  const { metrics: list } = await session.send('Performance.getMetrics');
  return Object.fromEntries(list.map(({ name, value }) => [name, value]));
}

test(`eight grippers at full rate, ${SECONDS} s`, async () => {
  const more = Array.from({ length: GRIPPERS }, (_, index) => ['--gripper', `g${index + 1}=sim://wsg50`]).flat();
  const served = await gateway({ more });
  const launched = await browser();
  const stops = Array.from({ length: GRIPPERS }, (_, index) => keepMoving(served, `g${index + 1}`));
  const whole = await launched.newBrowserCDPSession();
  for (const view of ['operate', 'all']) {
    const visitor = await visit(launched, served, { path: `/#/g1/${view}`, width: 1280, height: 800 });
    const { page, context } = visitor;
    const session = await context.newCDPSession(page);
    await session.send('Performance.enable');
    await page.waitForFunction(() => document.querySelectorAll('.chip').length === 8);
    // The first seconds are those of compilers and caches.
    await page.waitForTimeout(3000);
    const before = { cpu: await cpuSeconds(whole), heap: await heapBytes(session), metrics: await metrics(session), at: performance.now() };
    await page.waitForTimeout(SECONDS * 1000);
    const seconds = (performance.now() - before.at) / 1000;
    const cpu = await cpuSeconds(whole);
    const later = await metrics(session);
    const growth = (await heapBytes(session)) - before.heap;
    const shares = Object.fromEntries(Object.entries(cpu).map(([type, spent]) => [type, (spent - (before.cpu[type] ?? 0)) / seconds]));
    const share = Object.values(shares).reduce((sum, one) => sum + one, 0);
    const percent = (value) => `${(value * 100).toFixed(1)} %`;
    const spent = (name) => percent((later[name] - before.metrics[name]) / seconds);
    console.log(`${view}: ${percent(share)} of one core (${Object.entries(shares).map(([type, one]) => `${type} ${percent(one)}`).join(', ')}); main thread ${spent('TaskDuration')}, of it script ${spent('ScriptDuration')}, layout ${spent('LayoutDuration')}, style ${spent('RecalcStyleDuration')}; heap ${(before.heap / 1e6).toFixed(2)} MB ${growth < 0 ? '' : '+'}${(growth / 1e6).toFixed(2)} MB; ${later.Nodes} nodes`);
    assert.ok(share < MOST_CPU, `${percent(share)} of one core`);
    assert.ok(growth < MOST_GROWTH_BYTES, `the heap has grown by ${growth} bytes`);
    assertClean(visitor);
    await visitor.close();
  }
  await Promise.all(stops.map((stop) => stop()));
});

test('what is useful is on the screen within 300 ms', async () => {
  const served = await gateway();
  const launched = await browser();
  const times = [];
  for (let count = 0; count < 5; count += 1) {
    // Each time a window in which nothing is cached.
    const visitor = await visit(launched, served);
    await visitor.page.waitForFunction(() => performance.getEntriesByName('useful').length > 0);
    times.push(await visitor.page.evaluate(() => performance.getEntriesByName('useful')[0].startTime));
    assertClean(visitor);
    await visitor.close();
  }
  times.sort((a, b) => a - b);
  console.log(`useful after ${times.map(Math.round).join(', ')} ms`);
  assert.ok(times[2] < MOST_FIRST_MS, `${times}`);
});
