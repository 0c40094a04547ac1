// Support for the browser tests: the real gateway, Debian's Chromium, and pages watched for errors. The system chooses
// ports; every wait is for a condition; all started processes are ended.

import assert from 'node:assert/strict';
import { spawn, spawnSync } from 'node:child_process';
import { existsSync, mkdirSync, mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { createServer, request } from 'node:http';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, afterEach } from 'node:test';
import { fileURLToPath } from 'node:url';

const ROOT = fileURLToPath(new URL('../../', import.meta.url));
const installed = createRequire(join(ROOT, 'target/browser/package.json'));
const { chromium } = installed('playwright-core');

export const AXE = installed.resolve('axe-core/axe.min.js');
export const SHOTS = join(ROOT, 'target/browser/screenshots');
export const ASSETS = join(ROOT, 'src/interfaces/dashboard/assets/');

/** Deadline for anything without a time limit of its own. A busy machine is slow but still correct. */
export const DEADLINE_MS = 30_000;

/** The browser of the measurements. */
export const CHROMIUM = process.env.CHROMIUM ?? '/usr/bin/chromium';

/** The same browser without windows of its own: a page costs it a third of the processor time. */
const SHELL = '/usr/bin/chromium-headless-shell';
const CHEAPEST = process.env.CHROMIUM === undefined && existsSync(SHELL) ? SHELL : CHROMIUM;

export const FLAGS = [
  '--disable-gpu',
  '--disable-quic',
  '--no-first-run',
  '--disable-background-networking',
  '--disable-component-update',
  '--disable-sync',
];

/** Returns all texts of a language: those of the first screen, and those that are loaded after it. */
export async function textsOf(language) {
  const modules = await Promise.all(['', '-more'].map((part) => import(`${ASSETS}locales/${language}${part}.js`)));
  return Object.assign({}, ...modules.flatMap(Object.values));
}

/** Clean-up functions, run in reverse order. */
export const started = [];

/** Runs all clean-up functions, even if some fail. */
export async function endAll() {
  const errors = [];
  while (started.length > 0) {
    try {
      await started.pop()();
    } catch (error) {
      errors.push(error);
    }
  }
  if (errors.length > 0) throw new AggregateError(errors);
}

export async function until(what, look) {
  const end = Date.now() + DEADLINE_MS;
  for (;;) {
    const found = await look();
    if (found) return found;
    assert.ok(Date.now() < end, `not within ${DEADLINE_MS} ms: ${what}`);
    await new Promise((resolve) => {
      setTimeout(resolve, 20);
    });
  }
}

const program = process.env.WSG_GATEWAY_PROGRAM ?? join(ROOT, 'target/debug/wsg-gateway');

/** Creates a token or a PIN in a file, and returns its secret. */
export function token(file, name, role, ...more) {
  const created = spawnSync(program, ['token', '--tokens', file, 'create', '--name', name, '--role', role, ...more]);
  assert.equal(created.status, 0, String(created.stderr));
  return String(created.stdout).trim();
}

/** Starts the program, and waits for a match on standard output. */
async function run(flags, looksFor) {
  const child = spawn(program, flags, { stdio: ['ignore', 'pipe', 'pipe'] });
  const ended = new Promise((resolve) => {
    child.once('exit', resolve);
  });
  let output = '';
  let log = '';
  child.stdout.on('data', (text) => {
    output += text;
  });
  child.stderr.on('data', (text) => {
    log += text;
  });
  const kill = async (signal = 'SIGKILL') => {
    child.kill(signal);
    // A failed test can leave the process stopped.
    child.kill('SIGCONT');
    await ended;
  };
  started.push(() => kill('SIGTERM'));
  const says = (pattern) =>
    until(`${flags.join(' ')} prints ${pattern}`, () => {
      assert.equal(child.exitCode, null, `the process ended: ${log}`);
      return pattern.exec(output)?.[1];
    });
  return { child, kill, says, said: await says(looksFor) };
}

/** Starts a simulated device. `happens` injects changes through its control port. */
export async function simulator() {
  const {
    child,
    says,
    said: url,
  } = await run(['sim', 'tcp://127.0.0.1:0', '--control', '127.0.0.1:0'], /(tcp:\/\/127\.0\.0\.1:[1-9]\d*)/);
  const devices = await says(/fault injection at (http:\S+)/);
  const happens = async (change) => {
    const answer = await fetch(`${devices}/0`, { method: 'POST', body: JSON.stringify(change) });
    assert.ok(answer.ok, await answer.text());
  };
  return { child, url, happens };
}

/**
 * Starts a gateway, and reads its state with the token `secret`; `port` 0 is any free port. Waits until the grippers in
 * `connects` are connected, or all. `reload` replaces its configuration `toml`.
 */
export async function gateway({ port = 0, more = [], toml = '', connects = null, secret = null } = {}) {
  const own = ['--listen', `127.0.0.1:${port}`, '--zenoh-listen', 'tcp/127.0.0.1:0', '--journal', ':memory:'];
  let file = null;
  if (toml !== '') {
    const folder = mkdtempSync(join(tmpdir(), 'wsg-browser-'));
    started.push(() => rmSync(folder, { recursive: true }));
    file = join(folder, 'gateway.toml');
    writeFileSync(file, toml);
    own.push('--config', file);
  }
  const { child, kill, says, said: url } = await run([...own, ...more], /(http:\/\/127\.0\.0\.1:\d+)\//);
  const ask = async (method, path, body) => {
    const headers = secret === null ? {} : { authorization: `Bearer ${secret}` };
    // On a busy machine, a motion can take longer than the gateway waits by default.
    const query = /\/(home|move|grip|release)$/.test(path) ? '?wait_ms=60000' : '';
    const response = await fetch(`${url}/api/v1/${path}${query}`, {
      method,
      headers,
      body: body && JSON.stringify(body),
    });
    return response.json();
  };
  const reload = (changed) => {
    writeFileSync(file, changed);
    child.kill('SIGHUP');
  };
  const one = { url, child, port: Number(new URL(url).port), kill, says, ask, reload };
  await until('the grippers are connected', async () => {
    const { grippers } = await ask('GET', 'grippers');
    return (
      grippers.length > 0 &&
      grippers.every(({ gripper, link }) => link === 'connected' || connects?.includes(gripper) === false)
    );
  });
  return one;
}

/** A proxy to the gateway that never answers reads of lists, and refuses WebSockets. `held` is the number of waiting
 * reads. */
export async function slowReads({ url }) {
  const waiting = new Set();
  const proxy = createServer((asked, answer) => {
    if (asked.method === 'GET' && /^\/api\/v1\/(events|grips)|^\/metrics/.test(asked.url)) {
      waiting.add(answer);
      return;
    }
    const { method, headers } = asked;
    const passed = request(new URL(asked.url, url), { method, headers }, (response) => {
      answer.writeHead(response.statusCode, response.headers);
      response.pipe(answer);
    });
    passed.on('error', () => answer.destroy());
    asked.pipe(passed);
  });
  proxy.on('upgrade', (_asked, socket) => socket.destroy());
  await new Promise((resolve) => {
    proxy.listen(0, '127.0.0.1', resolve);
  });
  started.push(() => {
    proxy.closeAllConnections();
    proxy.close();
  });
  return { url: `http://127.0.0.1:${proxy.address().port}`, held: () => waiting.size };
}

/** Prints what the pages of a failed test show. */
async function explain(launched) {
  for (const page of launched.contexts().flatMap((context) => context.pages())) {
    const text = await page.innerText('body', { timeout: 2000 }).catch(String);
    console.log(`${page.url()} shows: ${text.replace(/\n+/g, ' | ')}`);
  }
}

/** Launches a browser. */
export const launch = (more = {}) =>
  chromium.launch({ executablePath: CHEAPEST, args: FLAGS, chromiumSandbox: false, ...more });

/**
 * Launches the browser for all tests of a file, with more flags or another program. All that a test starts ends with the
 * test.
 */
export async function browser(more = [], executablePath = CHEAPEST) {
  const launched = await launch({ executablePath, args: [...FLAGS, ...more] });
  afterEach(({ passed }) => passed || explain(launched));
  afterEach(endAll);
  after(() => launched.close());
  return launched;
}

/**
 * The silence after which a page covers its values, ends a jog and raises an alarm of its own, and that after which it
 * replaces its connection: each as it is, and longer.
 */
export const LATE_MESSAGES = [
  ['STALE_AFTER_MS = 1200;', 'STALE_AFTER_MS = 20_000;'],
  ['RENEWED_AFTER_MS = 4000;', 'RENEWED_AFTER_MS = 25_000;'],
];

/**
 * All times of a page that a busy machine can exceed, each with the longer one that tests use instead. The others are
 * the time after which the page repeats a FAST STOP as an HTTP request, which replaces the first; the time after which
 * it reports that a FAST STOP has failed; the duration of a jog's lease; and the silence that ends steering.
 */
export const LONGER_TIMES = [
  ...LATE_MESSAGES,
  ['here: 300,', 'here: 20_000,'],
  ['STOPS_WITHIN_MS = 3000;', 'STOPS_WITHIN_MS = 20_000;'],
  ['LIVES_MS = 1000;', 'LIVES_MS = 20_000;'],
  ['SILENT_AFTER_MS = 200;', 'SILENT_AFTER_MS = 10_000;'],
];

let visitors = 0;

/** Name of the next visitor. A page without a name asks for one before it takes control. */
function nextName() {
  visitors += 1;
  return `tester-${visitors}`;
}

/**
 * Opens a fresh browser context with a watched page, until the test ends. `hasOwnTimes` leaves the page's times as they
 * are, for tests of these times; other pages have `LONGER_TIMES`. `name` is the person's name; null for a page that does
 * not know it yet.
 */
export async function visit(
  launched,
  { url },
  { path = '/', width = 1280, height = 800, hasOwnTimes = false, name = nextName(), ...more } = {},
) {
  const context = await launched.newContext({
    viewport: { width, height },
    locale: 'en-GB',
    timezoneId: 'UTC',
    ...more,
  });
  started.push(() => context.close());
  context.setDefaultTimeout(DEADLINE_MS);
  if (name !== null)
    await context.addInitScript((given) => {
      // Stored as by the page's `model/prefs.js`.
      const key = `wsg${new URL('.', location.href).pathname.slice(0, -1)}.name`;
      if (localStorage.getItem(key) === null) localStorage.setItem(key, JSON.stringify(given));
    }, name);
  const page = await context.newPage();
  const wrong = [];
  /** While the gateway is away on purpose, connection errors are allowed. */
  const allowed = { connections: false };
  const isAllowed = (text) =>
    allowed.connections && /ERR_CONNECTION|ERR_EMPTY_RESPONSE|WebSocket|ERR_SOCKET/.test(text);
  page.on('console', (message) => {
    if (['error', 'warning'].includes(message.type()) && !isAllowed(message.text()))
      wrong.push(`${message.type()}: ${message.text()} ${message.location().url}`);
  });
  page.on('pageerror', (error) => wrong.push(`exception: ${error.stack}`));
  page.on('request', (request) => {
    const { protocol, host } = new URL(request.url());
    if (!['data:', 'blob:'].includes(protocol) && host !== new URL(url).host) wrong.push(`request to ${request.url()}`);
  });
  if (!hasOwnTimes) await change(page, LONGER_TIMES);
  await page.goto(url + path);
  return { page, context, wrong, allowed, close: () => context.close() };
}

/** Sets the user's name. */
export async function named(page, name) {
  await page.fill('#my-name', name);
  await page.press('#my-name', 'Tab');
}

/** Takes control of the shown gripper. */
export async function controlled(page) {
  await page.click('#take-control');
  await page.waitForSelector('.status.tone-mine');
}

/** Takes control of the shown gripper, and homes it. */
export async function homed(page) {
  await controlled(page);
  // On a small screen, the button can be scrolled to the place of the last click.
  await page.waitForSelector('html:not([data-pressed]) #home:enabled');
  await page.click('#home');
  await page.waitForSelector('.last[data-outcome=SUCCESS]');
  await page.waitForSelector('#release:enabled');
}

/** Stops all grippers, and waits until the notice is old enough to be pressed. */
export async function stopped(page) {
  await page.click('#stop');
  await page.waitForSelector('.alarm-badge.tone-critical');
  await rendered(page);
  await page.waitForSelector('.strip[data-fresh]', { state: 'detached' });
}

/** Waits until the page has rendered what its scripts have changed. */
export function rendered(page) {
  return page.evaluate(
    () =>
      new Promise((resolve) => {
        requestAnimationFrame(() => setTimeout(resolve));
      }),
  );
}

/** Changes to the scripts of each page, as pairs of old and new text, and those whose old text was found. */
const changesOf = new WeakMap();

/** Changes texts in the scripts that a page loads from now on. Returns a set, which gets each change that is made. */
async function change(page, pairs) {
  const known = changesOf.get(page);
  const { found } = known ?? { found: new Set() };
  changesOf.set(page, { pairs: [...pairs, ...(known?.pairs ?? [])], found });
  if (known) return found;
  await page.route('**/*.js*', async (route) => {
    try {
      const response = await route.fetch({ maxRetries: 2 });
      let body = await response.text();
      for (const pair of changesOf.get(page).pairs) {
        const [from, to] = pair;
        if (body.includes(from)) found.add(pair);
        body = body.replace(from, () => to);
      }
      await route.fulfill({ response, body });
    } catch {
      // Meanwhile the gateway can go away, or the page can be closed.
      await route.abort('connectionrefused').catch(() => {});
    }
  });
  return found;
}

/** Reloads the page with other constants in its modules, also later: `changes` are pairs of old and new text. */
export async function altered(page, ...changes) {
  const found = await change(page, changes);
  await page.reload();
  started.push(() =>
    assert.deepEqual(
      changes.filter((pair) => !found.has(pair)),
      [],
      'replaced in the page',
    ),
  );
}

/** Lets a page wait longer for an answer that the test keeps back. */
export const LATE_ANSWERS = [5000, 8000].map((ms) => [
  `ANSWERS_WITHIN_MS = ${ms};`,
  `ANSWERS_WITHIN_MS = ${2 * DEADLINE_MS};`,
]);

/**
 * Repeats a FAST STOP until the page shows that it is confirmed. A confirmation that comes after the answer is not
 * shown to a signed-out page or for a fleet.
 */
export function confirmed(page, button, selector) {
  return until(selector, async () => {
    await page.click(button);
    return appears(page, selector, 5000);
  });
}

/** Whether an element appears within a time. */
export function appears(page, selector, timeout) {
  return page.waitForSelector(selector, { timeout }).then(
    () => true,
    () => false,
  );
}

/** Sends a command until its frames are shown in the log: a busy page misses frames, and says so. */
export async function exchanged(page, send, selector) {
  const gaps = async () => (await page.locator('[data-row=gap]').allInnerTexts()).join('\n');
  let outcome = null;
  while (outcome !== 'shown') {
    const before = await gaps();
    await send();
    outcome = await until(`${selector}, or a gap`, async () => {
      if ((await page.locator(selector).count()) > 0) return 'shown';
      return (await gaps()) === before ? null : 'gap';
    });
  }
}

/** Asserts no console messages, no exceptions and no requests to other hosts. */
export function assertClean({ wrong }) {
  assert.deepEqual(wrong, []);
}

/** Takes a screenshot for visual review, if `SCREENSHOTS` is set: a screenshot costs as much as a check of the layout. */
export async function shoot(page, name, options = {}) {
  if (!process.env.SCREENSHOTS) return;
  mkdirSync(SHOTS, { recursive: true });
  await page.screenshot({ path: join(SHOTS, `${name}.png`), ...options });
}
