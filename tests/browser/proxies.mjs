// The dashboard behind nginx, HAProxy and Caddy, with the configurations of the guide: below a path, at the default port
// of HTTP, and with compression and the buffers of nginx.

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { appears, assertClean, browser, confirmed, gateway, homed, started, token, until, visit } from './harness.mjs';

const GUIDE = readFileSync(new URL('../../deploy/guide/proxy.md', import.meta.url), 'utf8');

/** The configuration of a proxy in the guide. */
function configuration(language) {
  const [, text] = new RegExp(`\n\`\`\`${language}\n([^]*?)\n\`\`\`\n`).exec(GUIDE);
  return text;
}

/** Returns ports that are free now. */
async function freePorts(count) {
  const servers = await Promise.all(
    Array.from({ length: count }, async () => {
      const server = createServer();
      await new Promise((resolve) => {
        server.listen(0, '127.0.0.1', resolve);
      });
      return server;
    }),
  );
  const ports = servers.map((server) => server.address().port);
  await Promise.all(
    servers.map(
      (server) =>
        new Promise((resolve) => {
          server.close(resolve);
        }),
    ),
  );
  return ports;
}

const [port, statsPort] = await freePorts(2);
const HERE = `127.0.0.1:${port}`;
/** Below the default port of HTTP, which an unprivileged proxy cannot listen on. */
const PLANT = 'http://plant.example';
// The pages have their own times: to change them, the test would fetch the scripts itself, and only the browser can
// resolve the name.
const launched = await browser([`--host-resolver-rules=MAP plant.example:80 ${HERE}`]);

/** Starts a program in a directory of its own with a configuration, and waits until it accepts connections. */
async function proxy(program, flags, write) {
  const folder = mkdtempSync(join(tmpdir(), 'wsg-proxy-'));
  started.push(() => rmSync(folder, { recursive: true, force: true }));
  const file = join(folder, 'configuration');
  writeFileSync(file, write(folder));
  const environment = { ...process.env, XDG_DATA_HOME: folder, XDG_CONFIG_HOME: folder };
  const child = spawn(program, [...flags, file], { cwd: folder, env: environment, stdio: ['ignore', 'pipe', 'pipe'] });
  let log = '';
  child.stdout.on('data', (text) => {
    log += text;
  });
  child.stderr.on('data', (text) => {
    log += text;
  });
  let failure = null;
  const ended = new Promise((resolve) => {
    child.once('exit', resolve);
    child.once('error', (error) => {
      failure = error;
      resolve();
    });
  });
  started.push(async () => {
    child.kill('SIGTERM');
    await ended;
  });
  await until(`${program} accepts connections`, async () => {
    assert.ok(child.exitCode === null && failure === null, `${program} ended: ${failure} ${log}`);
    return fetch(`http://${HERE}/`).catch(() => null);
  });
}

/** Starts nginx with the guide's configuration, changed by `change`. It compresses all that it can. */
function nginx(served, change = (text) => text) {
  const own = change(
    configuration('nginx')
      .replace('listen 80;', `listen ${HERE};`)
      .replace('127.0.0.1:8080', `127.0.0.1:${served.port}`),
  );
  const user = process.getuid() === 0 ? 'user root;' : '';
  const places = (folder) =>
    ['client_body', 'proxy', 'fastcgi', 'uwsgi', 'scgi']
      .map((name) => `${name}_temp_path ${folder}/${name};`)
      .join('\n');
  return proxy(
    'nginx',
    ['-c'],
    (folder) => `${user}
daemon off;
pid ${folder}/pid;
error_log stderr;
events {}
http {
access_log off;
gzip on;
gzip_proxied any;
gzip_types *;
${places(folder)}
${own}
}
`,
  );
}

/** Starts HAProxy with the guide's configuration, and with a page of the results of its checks. */
function haproxy(served) {
  const own = configuration('haproxy')
    .replace('bind :80', `bind ${HERE}`)
    .replace('127.0.0.1:8080', `127.0.0.1:${served.port}`);
  const stats = `\nlisten stats\n    bind 127.0.0.1:${statsPort}\n    stats enable\n    stats uri /\n`;
  return proxy('haproxy', ['-db', '-f'], () => `${own}${stats}`);
}

function caddy(served) {
  const own = configuration('caddy')
    .replace('http://plant.example', `http://:${port}`)
    .replace('127.0.0.1:8080', `127.0.0.1:${served.port}`);
  const text = `{\n    admin off\n    auto_https off\n}\n${own}\n`;
  return proxy('caddy', ['run', '--adapter', 'caddyfile', '--config'], () => text);
}

/** Starts a gateway with an operator's token and the proxy's host name. */
async function guarded() {
  const folder = mkdtempSync(join(tmpdir(), 'wsg-tokens-'));
  started.push(() => rmSync(folder, { recursive: true }));
  const file = join(folder, 'tokens.json');
  const secret = token(file, 'anna', 'operator');
  const more = ['--tokens', file, '--gripper', 'left=sim://wsg50?part_mm=20'];
  return { secret, served: await gateway({ more, secret, toml: 'hosts = ["plant.example"]\n' }) };
}

/** Signs in, takes control, grips a part, and stops, on the page at `path`. */
async function drive({ secret, served }, path) {
  const visitor = await visit(launched, { url: PLANT }, { path, hasOwnTimes: true });
  const { page, context, wrong } = visitor;
  await page.waitForSelector('.sign-in');
  // The page is refused until it has signed in.
  wrong.length = 0;
  await page.fill('#token', secret);
  await page.click('.sign-in button[type=submit]');
  await page.waitForSelector('.jaws');
  const [cookie] = await context.cookies();
  assert.deepEqual([cookie.name, cookie.path], [`wsg_session_${served.port}`, path]);
  await homed(page);
  const stored = await page.evaluate(() => Object.keys(localStorage));
  const prefix = `wsg${path.slice(0, -1)}.`;
  assert.ok(stored.length > 0 && stored.every((key) => key.startsWith(prefix)), `${stored}`);

  await page.fill('#width', '20');
  await page.click('#grip:enabled');
  // The values are live: the page shows several of them before the grip ends.
  const shown = new Set();
  await until('the width changes while the fingers move', async () => {
    shown.add(await page.innerText('.figure-main'));
    return shown.size >= 4;
  });
  await page.waitForSelector('[data-outcome=PART_HELD]');

  await page.click('#stop');
  await until('the gripper is stopped', async () => (await served.ask('GET', 'grippers/left/state')).fast_stop);
  await confirmed(page, '#stop', '.stopped:has-text("FAST STOP confirmed")');
  assertClean(visitor);

  // The stream arrives although the proxy may collect what it passes on.
  const abort = new AbortController();
  const stream = await fetch(`http://${HERE}${path}api/v1/stream?topics=state`, {
    headers: { authorization: `Bearer ${secret}` },
    signal: abort.signal,
  });
  const { value } = await stream.body.getReader().read();
  assert.match(new TextDecoder().decode(value), /event: ?state/);
  abort.abort();

  await page.goto(`${PLANT}${path}docs`);
  await page.waitForSelector('#swagger-ui .opblock');
  assert.equal(await page.inputValue('.servers select'), `${PLANT}${path.slice(0, -1)}`);
  await page.goto(`${PLANT}${path}docs/guide`);
  assert.equal(page.url(), `${PLANT}${path}docs/guide/`);
  await page.click('a[href="proxy"]');
  await page.click('nav a:has-text("Dashboard")');
  await page.waitForSelector('.jaws');
  assert.ok(page.url().startsWith(`${PLANT}${path}#`), page.url());
  assertClean(visitor);
}

test('nginx, below a path', async () => {
  const cell = await guarded();
  await nginx(cell.served);
  await drive(cell, '/left/');
});

test('nginx, at the root, with the default port in the Host header', async () => {
  const cell = await guarded();
  await nginx(cell.served, (text) =>
    text
      .replaceAll('/left/', '/')
      .replace('Host $http_host', 'Host $host:80')
      .replace(/.*proxy_(cookie_path|redirect).*\n/g, ''),
  );
  await drive(cell, '/');
});

test('HAProxy, below a path, with its default check', async () => {
  const cell = await guarded();
  await haproxy(cell.served);
  await until('the check passes', async () => {
    const table = await (await fetch(`http://127.0.0.1:${statsPort}/;csv`)).text();
    assert.doesNotMatch(table, /L7STS|L7RSP/);
    return table.includes('L7OK');
  });
  await drive(cell, '/left/');
});

test('Caddy, below a path', async () => {
  const cell = await guarded();
  await caddy(cell.served);
  await drive(cell, '/left/');
});

for (const [header, notice] of [
  ['Host', `another host name than ${PLANT}`],
  ['Upgrade', 'headers Upgrade and Connection'],
]) {
  test(`the page names the cause if the proxy does not pass on ${header}`, async () => {
    const served = await gateway({ toml: 'hosts = ["plant.example"]\n' });
    await nginx(served, (text) => text.replace(new RegExp(`.*proxy_set_header ${header} .*\n`), ''));
    const { page } = await visit(launched, { url: PLANT }, { path: '/left/', hasOwnTimes: true });
    await page.waitForSelector(`[role=alert]:has-text("${notice}")`);
    // The guide is readable, although the page has no connection.
    const [guide] = await Promise.all([page.waitForEvent('popup'), page.click('.missing a')]);
    await guide.waitForSelector('h1:has-text("Behind a proxy")');
    assert.equal(await appears(page, '.jaws', 100), false);
  });
}
