// The log of frames and the command editor.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';

import { assertClean, browser, exchanged, gateway, shoot, simulator, until, visit } from './harness.mjs';

const launched = await browser();

const text = (page, selector) => page.locator(selector).first().innerText();

/** Sends a request that the gateway never answers by itself. */
const loop = (served, payload = 'beef') => served.ask('POST', 'grippers/left/raw', { id: 0x06, payload });

test('the log goes on while another view is shown, in local time', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/log', timezoneId: 'Asia/Kolkata' });
  const { page } = visitor;
  await page.waitForSelector('[data-row=updates]:has-text("automatic updates")');
  let before = null;
  const sendElsewhere = async () => {
    await page.click('[data-view=operate]');
    await page.waitForSelector('.jaws');
    before = Date.now();
    await loop(served);
    await page.click('[data-view=log]');
  };
  await exchanged(page, sendElsewhere, '.frame.sent:has-text("Loop")');
  const shown = await text(page, '.frame.sent:has-text("Loop")');
  const [, hours, minutes] = /(\d\d):(\d\d):\d\d\.\d{3}/.exec(shown);
  const local = new Date(before + 5.5 * 3600_000);
  const apart = Number(hours) * 60 + Number(minutes) - (local.getUTCHours() * 60 + local.getUTCMinutes());
  assert.ok([0, 1, -1439].includes(apart), shown);
  assertClean(visitor);
});

test('automatic updates are not sent while another view hides the log', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served);
  const { page } = visitor;
  let heard = [];
  page.on('websocket', (socket) => socket.on('framereceived', ({ payload }) => heard.push(String(payload))));
  await page.waitForSelector('#take-control');
  await page.click('[data-view=log]');
  await page.waitForSelector('[data-row=updates]');
  await page.click('[data-view=operate]');
  await until('the page leaves updates out', () => heard.some((message) => message.includes('"exchanges"')));
  heard = [];
  await loop(served);
  await until('the log goes on', () => heard.some((message) => message.includes('Loop')));
  assert.deepEqual(
    heard.filter((message) => message.includes('GetWidth')),
    [],
  );
  await page.click('[data-view=log]');
  await page.waitForSelector('[data-row=away] ~ .frame:has-text("Loop")');
  await page.waitForSelector('[data-row=away] ~ [data-row=updates]');
  assertClean(visitor);
});

test('frames are filtered, copied and saved, and a pause is marked', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/log' });
  const { page } = visitor;
  await page.waitForSelector('[data-row=updates]');
  let payload = 'be00';
  // Each try has its own bytes, which the filters below find.
  const sendNext = () => {
    payload = (Number.parseInt(payload, 16) + 1).toString(16);
    return loop(served, payload);
  };
  await exchanged(page, sendNext, '.frame.received:has-text("Loop")');
  const readStatistics = () => served.ask('POST', 'grippers/left/raw', { id: 0x42, payload: '00' });
  await exchanged(page, readStatistics, '.frame.received:has-text("GetStatistics")');
  const only = (count) =>
    page.waitForFunction((wanted) => document.querySelectorAll('.frame').length === wanted, count);
  await page.fill('#log-filter', `06h ${payload}`);
  await only(2);
  assert.equal(await page.locator('[data-row=updates]').count(), 0, 'a filter hides folded updates');
  await page.click('[data-choice=direction-received]');
  await only(1);
  await page.fill('#log-filter', 'E_SUCCESS statistics');
  await page.waitForSelector('.frame:has-text("GetStatistics")');
  await page.fill('#log-filter', 'E_NO_SUCH');
  await page.waitForSelector('p:has-text("No frame matches the filter.")');
  await page.fill('#log-filter', `06h ${payload}`);
  await page.click('[data-choice=direction-]');
  await only(2);
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
  await page.click('#copy-log');
  await page.waitForSelector('[role=status]:has-text(" lines copied.")');
  const copied = await page.evaluate(() => navigator.clipboard.readText());
  const lines = copied.trimEnd().split('\n');
  assert.equal(await text(page, '[role=status]:has-text(" lines copied.")'), `${lines.length} lines copied.`);
  // A line about missing frames has no arrow.
  const [sent, received, ...others] = lines.filter((line) => / (->|<-) /.test(line));
  const bytes = `06 02 00 be ${payload.slice(2)}`;
  assert.match(
    sent,
    new RegExp(`^\\d{4}-\\d\\d-\\d\\d \\d\\d:\\d\\d:\\d\\d\\.\\d{3} -> aa aa aa ${bytes} \\S\\S \\S\\S {2}Loop `),
  );
  assert.match(received, /<- aa aa aa 06 .*Loop/);
  assert.deepEqual(others, []);
  const [file] = await Promise.all([page.waitForEvent('download'), page.click('#save-log')]);
  assert.equal(file.suggestedFilename(), 'left-frames.txt');
  assert.equal(await readFile(await file.path(), 'utf8'), copied);
  await page.fill('#log-filter', '');
  await page.click('#pause-log');
  await loop(served);
  await page.waitForSelector('[data-row=paused]:has-text("left out while paused")');
  // The second click of a double click does not resume.
  await page.waitForSelector('html:not([data-pressed])');
  await page.click('#pause-log');
  await exchanged(page, readStatistics, '[data-row=paused] ~ .frame:has-text("GetStatistics")');
  await shoot(page, 'log-paused');
  assertClean(visitor);
});

test('damaged frames and skipped bytes are shown as such', async () => {
  const device = await simulator();
  const served = await gateway({ more: ['--gripper', `left=${device.url}`] });
  const visitor = await visit(launched, served, { path: '/#/left/log' });
  const { page } = visitor;
  await page.waitForSelector('[data-row=updates]');
  const damage = () => device.happens({ fault: { kind: 'corrupt_checksum', id: 0x43, times: 1 } });
  await exchanged(page, damage, '.frame.tone-high[data-damage=checksum]:has-text("GetWidth")');
  await page.fill('#log-filter', 'checksum wrong');
  await page.waitForSelector('.frame[data-damage=checksum]');
  await page.click('.frame[data-damage=checksum]');
  await page.waitForSelector('.byte');
  assertClean(visitor);
});

test('the editor has forms, and shows the frame as sent and its decoded reply', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/log' });
  const { page } = visitor;
  await page.waitForSelector('[data-row=updates]');
  await page.selectOption('#editor-command', { label: '30h SetAcceleration' });
  assert.equal(await page.inputValue('#editor-id'), '30h');
  await page.fill('#editor-field-0', '150');
  assert.equal(await page.inputValue('#editor-payload'), '150f');
  await page.fill('#editor-payload', '0x00 0x00 0x48 0x43');
  assert.equal(await page.inputValue('#editor-field-0'), '200', 'the fields follow the text');
  await page.fill('#editor-payload', '150,0f');
  const send = () => page.click('#editor-send');
  const decoded = '#answer:has-text("E_SUCCESS") #editor-decoded';
  await exchanged(page, send, `${decoded}:has-text("SetAcceleration")`);
  assert.equal(await text(page, '#editor-sent'), 'aa aa aa 30 04 00 00 00 16 43 de cd');
  await page.selectOption('#editor-command', { label: '31h GetAcceleration' });
  await exchanged(page, send, `${decoded}:has-text("GetAcceleration"):has-text("150")`);
  await shoot(page, 'editor');
  assertClean(visitor);
});

test('bytes are sent exactly as typed, and the device judges them', async () => {
  const served = await gateway();
  const visitor = await visit(launched, served, { path: '/#/left/log' });
  const { page } = visitor;
  await page.waitForSelector('[data-row=updates]');
  const send = async (label, payload) => {
    await page.selectOption('#editor-command', { label });
    await page.fill('#editor-payload', payload);
    await page.click('#editor-send');
  };
  await send('30h SetAcceleration', '1');
  await page.waitForSelector('.problem:has-text("wrong length")');
  assert.equal(await page.locator('#answer').count(), 0);
  await page.check('#editor-exact');
  const short = () => send('30h SetAcceleration', '1');
  await exchanged(page, short, '#answer:has-text("E_CMD_FORMAT_ERROR") #editor-sent:has-text("aa aa aa 30 01 00 01")');
  await send('32h SetForceLimit', '0x7fc00000');
  await page.waitForSelector('#answer:has-text("E_INVALID_PARAMETER")');
  // The gateway answers such reads itself for a while, but not these.
  const read = () => send('50h GetSystemInfo', '');
  for (let count = 0; count < 2; count += 1)
    await exchanged(page, read, '#answer:has-text("E_SUCCESS") #editor-received');
  await send('25h Grip', '1');
  await page.waitForSelector('.problem:has-text("25h cannot be sent with")');
  assertClean(visitor);
});
