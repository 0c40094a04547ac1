// Sign-in on a gateway whose clients need credentials.

import assert from 'node:assert/strict';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { browser, confirmed, gateway, started, token, until, visit } from './harness.mjs';

const launched = await browser();

async function guarded() {
  const directory = mkdtempSync(join(tmpdir(), 'wsg-signin-'));
  started.push(async () => rmSync(directory, { recursive: true }));
  const file = join(directory, 'tokens.json');
  const [operator, observer] = ['operator', 'observer'].map((role) => token(file, `anna-${role}`, role));
  const served = await gateway({ more: ['--tokens', file], secret: operator });
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

test('an observer sees the gripper and no way to move it', async () => {
  const { served, observer } = await guarded();
  const { page } = await visit(launched, served, {});
  await signIn(page, observer);
  await page.waitForSelector('.jaws');
  // The flags come after the controls, which are shown until the rights are known.
  await page.waitForSelector('.flags');
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
