// Sign-in on a gateway whose clients need credentials.

import assert from 'node:assert/strict';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { faults, violations } from './checks.mjs';
import { browser, confirmed, gateway, shoot, started, token, until, visit } from './harness.mjs';

const launched = await browser();

/** Starts a gateway whose clients need credentials. `fastStop` says who may trigger a FAST STOP: anyone by default. */
async function guarded({ fastStop = 'anyone' } = {}) {
  const directory = mkdtempSync(join(tmpdir(), 'wsg-signin-'));
  started.push(async () => rmSync(directory, { recursive: true }));
  const file = join(directory, 'tokens.json');
  const [operator, observer] = ['operator', 'observer'].map((role) => token(file, `anna-${role}`, role));
  const toml = `[access]\ntokens = ${JSON.stringify(file)}\nfast_stop = "${fastStop}"\n`;
  const served = await gateway({ toml, secret: operator });
  return { served, operator, observer, file };
}

async function signIn(page, secret) {
  await page.waitForSelector('.sign-in');
  await page.fill('#token', secret);
  await page.click('.sign-in button[type=submit]');
}

test('a stranger can only stop and sign in, and an operator operates', async () => {
  const { served, operator } = await guarded();
  const { page } = await visit(launched, served, {});
  await signIn(page, 'wsg_wrong');
  await page.waitForSelector('.sign-in [role=alert]');
  assert.equal(await page.locator('.jaws').count(), 0);
  await page.click('#stop');
  await until('the gripper is stopped', async () => (await served.ask('GET', 'grippers/left/state')).fast_stop);
  await confirmed(page, '#stop', '.stopped:has-text("FAST STOP confirmed")');
  await signIn(page, operator);
  await page.waitForSelector('.jaws');
  assert.match(await page.locator('.signed-in').innerText(), /anna-operator \(operator\)/);
  await page.waitForSelector('#take-control');
  const { holder } = await served.ask('POST', 'grippers/left/lease', {});
  assert.equal(holder, 'anna-operator');
  await page.click('button:has-text("Sign out")');
  await page.waitForSelector('.sign-in');
});

test('where a FAST STOP needs a credential, a stranger sees that STOP is not there', async () => {
  const { served, operator } = await guarded({ fastStop: 'credential' });
  for (const [width, locale, text] of [
    [1024, 'en-GB', /No STOP before you sign in/],
    [1024, 'de-DE', /Kein STOPP ohne Anmeldung/],
    [320, 'de-DE', /Kein STOPP ohne Anmeldung/],
  ]) {
    const { page } = await visit(launched, served, { width, locale });
    await page.waitForSelector('.sign-in');
    assert.match(await page.locator('#no-stop').innerText(), text);
    await page.keyboard.press('Escape');
    await page.waitForSelector('.stopped.tone-critical');
    assert.equal(await page.locator('#stop').count(), 0);
    assert.deepEqual([...(await faults(page)), ...(await violations(page))], []);
    await shoot(page, `no-stop-${width}-${locale}`);
    await signIn(page, operator);
    await page.waitForSelector('.jaws');
    await confirmed(page, '#stop', '.stopped p:text-matches("FAST STOP (confirmed|bestätigt)")');
    await page.context().close();
  }
});

test('a page whose user has to sign in asks nothing by itself', async () => {
  const { served, operator } = await guarded();
  const { page, context } = await visit(launched, served, { path: '/docs' });
  await page.clock.install();
  await page.goto(served.url);
  await page.waitForSelector('.sign-in');
  const refused = async () => (await served.ask('GET', 'events?kind=refused')).events.length;
  await until('the refusals of the first requests are recorded', async () => (await refused()) >= 2);
  const asked = [];
  page.on('request', (request) => asked.push(request.url()));
  page.on('websocket', (socket) => asked.push(socket.url()));
  // An hour in one go.
  await page.clock.runFor('01:00:00');
  assert.deepEqual(asked, []);
  // The user signs in on another page, and comes back.
  const other = await context.newPage();
  await other.goto(served.url);
  await signIn(other, operator);
  await other.waitForSelector('.jaws');
  await page.evaluate(() => document.dispatchEvent(new Event('visibilitychange')));
  await page.waitForSelector('.jaws');
});

test('an observer sees the gripper and no way to move it', async () => {
  const { served, observer } = await guarded();
  const { page } = await visit(launched, served, {});
  await signIn(page, observer);
  await page.waitForSelector('.jaws');
  // The alarms come after the controls, which are shown until the rights are known.
  await page.waitForSelector('.alarms-panel');
  await page.waitForSelector('.signed-in');
  assert.equal(await page.locator('#take-control, #home, #grip').count(), 0);
});

test("a PIN adds a person's rights to a panel until it is locked", async () => {
  const { served, observer, file } = await guarded();
  const pin = token(file, 'berta', 'operator', '--pin');
  const { page } = await visit(launched, served, {});
  await signIn(page, observer);
  await page.click('#enter-pin');
  const enter = async (digits) => {
    await page.fill('#pin', digits);
    await page.click('.pin button[type=submit]');
  };
  await enter(pin === '000000' ? '000001' : '000000');
  await page.waitForSelector('.pin [role=alert]');
  await enter(pin);
  await page.waitForSelector('#take-control');
  assert.match(await page.locator('.signed-in').innerText(), /berta \(operator\)/);
  const holder = async () => (await served.ask('GET', 'grippers/left/state')).lease_holder;
  await page.click('#take-control');
  await until('the page has control', async () => (await holder()) !== null);
  await page.click('#lock');
  await page.waitForSelector('#enter-pin');
  assert.equal(await page.locator('#take-control').count(), 0);
  await until('the lease ends with the rights', async () => (await holder()) === null);
});
