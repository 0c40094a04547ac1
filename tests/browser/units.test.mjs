// The dashboard's pure modules.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { ASSETS } from './harness.mjs';

const core = (name) => import(`${ASSETS}core/${name}.js`);
const { checksum, encode, fromHex, parts, toHex } = await core('frame');
const { interpretations, parse, parseId } = await core('bytes_text');
const { details, sentence } = await core('sentence');
const { Samples } = await core('ring');
const { asTyped, forceLimits, mistake, number, readings, speedLimits, typedFrom, widthLimits } = await core('limits');
const { acknowledged, noGateway, sorted } = await core('alarms');
const { FLAGS, has } = await core('flags');
const { connectionAfter, STALE_AFTER_MS } = await core('connection');
const { decimals } = await core('decimals');
const { delay } = await core('backoff');
const { bytesOf, cut } = await core('bytes');
const { numbered, ordered } = await core('newest');
const { spreadsheetTable } = await core('csv');
const { lacksFlags, namesIn, whyUnknown, withNames } = await core('values');

test('a table has the separator and the decimal sign of its language', () => {
  const table = `seq,part_id,width_mm,force_n,version,detail
1,4711.2,20.5,-3.25,0.2.0,"a ""b"", c"
2,x;y,,40,,"two
lines"
`;
  assert.equal(spreadsheetTable(table, 'en'), `\uFEFF${table}`);
  assert.equal(
    spreadsheetTable(table, 'de'),
    `\uFEFFseq;part_id;width_mm;force_n;version;detail
1;4711.2;20,5;-3,25;0.2.0;"a ""b"", c"
2;"x;y";;40;;"two
lines"
`,
  );
});

test('frames and checksums match the manuals', () => {
  const vectors = [
    'aaaaaa010000e810',
    'aaaaaa0102001234' + '6d66',
    'aaaaaa2002000000b3fd',
    'aaaaaa900200' + '0e00fd02',
    'aaaaaa2102001a0067cb',
    'aaaaaa21020000002804',
    'aaaaaa310600' + '0000000016431caf',
  ];
  for (const hex of vectors) {
    const { id, size, payload } = parts(fromHex(hex));
    assert.equal(size, payload.length, hex);
    assert.equal(toHex(encode(id, [...payload])), hex);
    assert.equal(checksum(fromHex(hex)), 0, hex);
  }
});

test('labels of an axis show their true values', () => {
  assert.deepEqual([50, 1, 0.5, 0.25, 0.2, 0.05, 0.001].map(decimals), [0, 0, 1, 2, 1, 2, 2]);
});

test('the editor accepts bytes, floats and texts, and names errors', () => {
  const bytes = (text) => {
    const { bytes: found, wrong } = parse(text);
    assert.equal(wrong, null, text);
    return toHex(found);
  };
  assert.equal(bytes(''), '');
  assert.equal(bytes('0x20'), '20');
  assert.equal(bytes('0x1234 0x123'), '34122301');
  assert.equal(bytes('150.0f'), '00001643');
  assert.equal(bytes('-1f .5f 1e2f'), '000080bf0000003f0000c842');
  assert.equal(bytes('"text" 7 255'), '7465787407ff');
  assert.equal(bytes('-5 -128'), 'fb80');
  assert.equal(bytes('150,0f'), '00001643');
  assert.equal(bytes('1, 2,3 0x20,"a,b", .5f ,5f'), '01020320612c620000003f0000003f');
  assert.equal(bytes('"a b\\"c"'), '6120622263');
  assert.equal(bytes('  0x00   20.0f 0x0A '), '000000a0410a');
  for (const [text, wrong] of [
    ['256', '256'],
    ['0x', '0x'],
    ['1.5', '1.5'],
    ['0x20 x', 'x'],
    ['"open', '"open'],
    ['"\u20ac"', '\u20ac'],
    ['-129', '-129'],
    ['1,000f', '1,000f'],
    ['1,,2', ','],
  ]) {
    assert.equal(parse(text).wrong, wrong, text);
  }
});

test('a form and its text have the same bytes', async () => {
  const { compose, fieldsOf, idText, MANUAL, valuesOf } = await core('manual');
  for (const [id, values, hex] of [
    [0x25, ['20', '50,5'], '0000a04100004a42'],
    [0x21, ['3', '-1.5', '50'], '030000c0bf00004842'],
    [0x43, ['1', '10'], '010a00'],
    [0x51, ['a "b" \\'], '6120226222205c'],
    [0x31, [], ''],
  ]) {
    const fields = fieldsOf(id);
    const { bytes, wrong } = parse(compose(fields, values));
    assert.deepEqual([toHex(bytes), wrong], [hex, null], idText(id));
    assert.deepEqual(
      valuesOf(fields, bytes),
      values.map((value) => value.replace(',', '.')),
      idText(id),
    );
  }
  assert.deepEqual(valuesOf(fieldsOf(0x25), [0, 0, 160, 65]), ['20', '']);
  assert.equal(MANUAL.size, 37);
});

test('an id is a number or has the manual’s notation', () => {
  for (const [text, id] of [
    ['0x31', 0x31],
    ['31h', 0x31],
    [' FFh ', 255],
    ['49', 49],
    ['0', 0],
  ])
    assert.equal(parseId(text), id, text);
  for (const text of ['', '256', '0x100', '-1', '1.5', 'xyz', '31'])
    assert.equal(parseId(text), text === '31' ? 31 : null, text);
});

test('bytes are shown as every type of their length', () => {
  const read = (hex) => Object.fromEntries(interpretations([...fromHex(hex)]).map(({ type, value }) => [type, value]));
  assert.deepEqual(read('ff'), { u8: 255, i8: -1, text: '\u00b7' });
  assert.deepEqual(read('f6ff'), { u16: 65526, i16: -10, text: '\u00b7\u00b7' });
  assert.deepEqual(read('00001643'), { f32: 150, u32: 1125515264, i32: 1125515264, text: '\u00b7\u00b7\u00b7C' });
  assert.deepEqual(read('61636b'), { text: 'ack' });
});

test('the ring keeps the newest samples, and a window keeps the peaks', () => {
  const samples = new Samples(1000, 2);
  for (let at = 0; at < 2500; at += 1) samples.push(at, [at, at === 2000 ? 500 : NaN]);
  assert.equal(samples.length, 1000);
  assert.equal(samples.time(0), 1500);
  const all = samples.window(2400, 2500, 1000);
  assert.deepEqual([all[0].length, all[0][0], all[1].at(-1), all[2][0]], [101, -0.101, 2499, null]);
  const few = samples.window(1500, 2500, 100);
  assert.ok(few[0].length <= 101, `${few[0].length}`);
  assert.equal(few[1].at(-1), 2499);
  const peaks = new Samples(1000, 1);
  for (let at = 0; at < 1000; at += 1) peaks.push(at, [at === 777 ? 80 : 1]);
  assert.ok(peaks.window(0, 1000, 50)[1].includes(80));
  assert.deepEqual(new Samples(10).window(0, 10, 10), [[], [], [], []]);
});

test('a gap survives downsampling', () => {
  for (const points of [2000, 40]) {
    const samples = new Samples(4096, 2);
    samples.gap();
    assert.equal(samples.length, 0, 'no gap before the first sample');
    for (let at = 0; at < 1000; at += 1) {
      samples.push(at, [NaN, at]);
      if (at === 499) for (let count = 0; count < 3; count += 1) samples.gap();
    }
    const [times, unknown, known] = samples.window(0, 1000, points);
    const gaps = known.flatMap((value, index) => (value === null ? [index] : []));
    assert.equal(gaps.length, 1, `${points} points`);
    assert.deepEqual([known[gaps[0] - 1], known[gaps[0] + 1]], [499, 500]);
    assert.equal(times[gaps[0]], -0.501);
    assert.ok(unknown.every((value) => value === null));
  }
  const mixed = new Samples(100, 1);
  for (let at = 0; at < 100; at += 1) mixed.push(at, [at % 3 ? at : NaN]);
  assert.ok(mixed.window(0, 100, 20)[0].length > 40, 'each missing sample is a gap');
});

test('ambiguous numbers are rejected, and fields never contain one', () => {
  for (const text of ['1,000', '5.000', ' 33.125 ', '-12,345', '999.999']) {
    assert.ok(Number.isNaN(number(text)), text);
    assert.equal(readings(text).length, 2, text);
  }
  assert.deepEqual(readings('1,050'), [1.05, 1050]);
  for (const [text, value] of [
    ['0,125', 0.125],
    ['1000', 1000],
    ['1234.567', 1234.567],
    ['12,34', 12.34],
    ['1.0000', 1],
  ]) {
    assert.equal(readings(text), null, text);
    assert.equal(number(text), value, text);
  }
  for (const value of [12.345, 5000, 0.125, 33.3331])
    assert.ok(Math.abs(number(asTyped(value)) - value) < 0.006, `${value}`);
  assert.equal(asTyped(null), '');
});

test('texts are cut by bytes, between characters', () => {
  assert.deepEqual(['abc', 'äöü', '€', '😀'].map(bytesOf), [3, 6, 3, 4]);
  assert.equal(cut('a'.repeat(50), 48), 'a'.repeat(48));
  assert.equal(cut('ä'.repeat(40), 48), 'ä'.repeat(24));
  assert.equal(cut('abc😀', 6), 'abc');
  assert.equal(cut('abc😀', 7), 'abc😀');
});

test('only the newest request counts', () => {
  const [asking, other] = [numbered(), numbered()];
  const [first, second] = [asking(), asking()];
  other();
  assert.deepEqual([first(), second()], [false, true]);
});

test('an answer counts unless a newer request was answered before', () => {
  const request = ordered();
  const [first, second, third] = [request(), request(), request()];
  assert.deepEqual([second(), first(), third(), second()], [true, false, true, false]);
});

test('a field that nobody has edited keeps all decimals of its value', () => {
  assert.deepEqual([typedFrom(19.865, asTyped(19.865)), typedFrom(19.865, '19.9')], [19.865, 19.9]);
  assert.deepEqual([typedFrom(null, ''), typedFrom(20, ''), typedFrom(undefined, '5')], [undefined, undefined, 5]);
});

test('limits combine device limits and soft limits', () => {
  const info = {
    stroke_mm: 110,
    min_speed_mm_s: 5,
    max_speed_mm_s: 420,
    min_force_n: 5,
    nominal_force_n: 80,
    overdrive_force_n: 120,
  };
  assert.deepEqual(widthLimits(info, { minus_mm: null }), { min: 0, max: 110, whose: 'device' });
  assert.deepEqual(widthLimits(info, { minus_mm: 10, plus_mm: 200 }), { min: 10, max: 110, whose: 'soft' });
  assert.equal(forceLimits(info, false).max, 80);
  assert.equal(forceLimits(info, true).max, 120);
  assert.equal(widthLimits(null, null).whose, null);
  const speeds = speedLimits(info);
  const found = [4.9, 5, 420, 420.1, NaN].map((value) => mistake(value, speeds));
  assert.deepEqual(found, ['low', null, null, 'high', 'missing']);
  assert.deepEqual(['1,5', ' 2.5 ', '', '1e3', '0x10', '-3', '1.2.3'].map(number), [1.5, 2.5, NaN, NaN, NaN, -3, NaN]);
});

test('only a message makes a connection live', () => {
  for (const before of ['connecting', 'live', 'silent', 'lost']) {
    assert.equal(connectionAfter(before, true, STALE_AFTER_MS), 'live');
  }
  const stale = (isOpen) =>
    ['connecting', 'live', 'silent', 'lost'].map((before) => connectionAfter(before, isOpen, Infinity));
  assert.deepEqual(stale(true), ['connecting', 'silent', 'silent', 'lost']);
  assert.deepEqual(stale(false), ['connecting', 'lost', 'lost', 'lost']);
});

test('a lost gateway is an alarm until it is back and acknowledged', () => {
  assert.equal(noGateway(null, false, 'now'), null);
  const alarm = noGateway(null, true, '2026-01-01T00:00:10Z');
  assert.equal(noGateway(alarm, true, '2026-01-01T00:00:20Z'), alarm, 'no change');
  const seen = acknowledged(alarm, '2026-01-01T00:00:30Z');
  assert.equal(noGateway(seen, false, '2026-01-01T00:00:40Z'), null);
  const ended = noGateway(alarm, false, '2026-01-01T00:00:40Z');
  assert.deepEqual([ended.began_at, ended.ended_at], ['2026-01-01T00:00:10Z', '2026-01-01T00:00:40Z']);
  assert.equal(acknowledged(ended, '2026-01-01T00:00:50Z'), null);
  assert.equal(noGateway(ended, true, '2026-01-01T00:01:00Z').ended_at, null, 'a recurrence is active again');
});

test('unacknowledged alarms come first, then active ones, by priority and age', () => {
  const alarm = (id, priority, began, ended, acknowledged) => ({
    id,
    priority,
    began_at: `2026-01-01T00:00:${began}Z`,
    ended_at: ended ? '2026-01-01T00:01:00Z' : null,
    acknowledged_at: acknowledged ? '2026-01-01T00:01:00Z' : null,
  });
  const all = [
    alarm('seen', 'critical', 10, false, true),
    alarm('over', 'critical', 20, true, false),
    alarm('low', 'low', 30, false, false),
    alarm('old', 'critical', 40, false, false),
    alarm('new', 'critical', 50, false, false),
  ];
  assert.deepEqual(
    sorted(all).map(({ id }) => id),
    ['new', 'old', 'low', 'over', 'seen'],
  );
});

test('numbers per part have mean, spread and trend', async () => {
  const { perPart, summary } = await core('statistics');
  assert.deepEqual(summary([4, 2, null, 3]), { mean: 3, spread: 1, trend: 1 });
  assert.deepEqual(summary([5]), { mean: 5, spread: null, trend: null });
  assert.deepEqual(summary([]), { mean: null, spread: null, trend: null });
  const grip = (part_id, outcome, width_mm, part_lost_at = null) => ({
    part_id,
    outcome,
    width_mm,
    force_n: 30,
    part_lost_at,
  });
  const parts = perPart([
    grip('b', 'PART_HELD', 20),
    grip('b', 'NO_PART', 5),
    grip('b', 'PART_HELD', 19, '2026-01-01T00:00:00Z'),
    grip(null, 'PART_HELD', 30),
  ]);
  assert.deepEqual(
    parts.map(({ part, count, rate, width }) => [part, count, rate, width.mean]),
    [
      ['b', 3, 1 / 3, 20],
      [null, 1, 1, 30],
    ],
  );
});

test('moving averages begin with the oldest value', async () => {
  const { averages } = await core('statistics');
  assert.deepEqual(averages([20, 21, 20]), [20, 20.2, 20.16]);
});

test('a histogram covers all values', async () => {
  const { histogram } = await core('statistics');
  assert.deepEqual(histogram([1, 2, 2, 5]), [
    { from: 1, to: 3, count: 3 },
    { from: 3, to: 5, count: 1 },
  ]);
  const [only, ...others] = histogram([20, 20]);
  assert.deepEqual([only.count, others.length], [2, 0]);
  assert.ok(only.from < 20 && only.to > 20);
});

test('older samples are put before the present ones', () => {
  const samples = new Samples(4);
  samples.push(10, [1, 1, 1]);
  samples.push(20, [2, 2, 2]);
  samples.fill([
    [-20, [7, 7, 7]],
    [-10, [8, null, 8]],
    [0, [9, 9, 9]],
    [15, [5, 5, 5]],
  ]);
  assert.deepEqual(
    Array.from({ length: samples.length }, (_, index) => [samples.time(index), samples.value(0, index)]),
    [
      [-10, 8],
      [0, 9],
      [10, 1],
      [20, 2],
    ],
  );
  assert.ok(Number.isNaN(samples.value(1, 0)));
});

test('an unknown value has a reason', () => {
  const state = {
    link: 'connected',
    age_ms: 4,
    state: 'IDLE',
    flags_raw: 0,
    referenced: false,
    width_mm: null,
    speed_mm_s: 0,
    force_n: null,
    temperature_c: null,
    stale: ['force_n'],
  };
  const all = (more) =>
    ['state', 'flags', 'width_mm', 'speed_mm_s', 'force_n', 'temperature_c'].map((name) =>
      whyUnknown({ ...state, ...more }, name),
    );
  assert.deepEqual(all({}), [null, null, 'not_referenced', null, 'missing', 'awaited']);
  assert.deepEqual(all({ referenced: true, stale: ['width_mm'] }).slice(2, 5), ['missing', null, 'awaited']);
  const lost = { link: 'reconnecting', age_ms: null, state: null, flags_raw: null, referenced: null, stale: [] };
  assert.deepEqual(all({ ...lost, speed_mm_s: null }), Array(6).fill('link'));
  const mute = { link: 'unresponsive', flags_raw: null, stale: ['flags'] };
  assert.deepEqual([lacksFlags({ ...state, ...mute }), lacksFlags({ ...state, ...mute, age_ms: null })], [true, false]);
});

test('the cause of an alarm names the unknown values', () => {
  const cause = 'width_mm (the device answers E_CMD_FAILED (18)), force_n (not sent by the device)';
  assert.deepEqual(namesIn(cause), ['width_mm', 'force_n']);
  assert.equal(
    withNames(cause, (name) => name.toUpperCase()),
    'WIDTH_MM (the device answers E_CMD_FAILED (18)), FORCE_N (not sent by the device)',
  );
});

test('events name the values that are unknown, and known again', () => {
  const of = (event) => sentence({ kind: 'device', event, values: ['width_mm'], cause: 'silent' });
  assert.deepEqual([of('values_unknown').key, of('values_known').key], ['event.values_unknown', 'event.values_known']);
  assert.deepEqual([of('values_unknown').values, of('values_unknown').with.cause], [['width_mm'], 'silent']);
});

test('events of servo sessions name the adapter and the reason in words, once', () => {
  const event = { kind: 'device', event: 'servo_ended', adapter: 'moves', reason: 'silence', accepted: 7, refused: 0 };
  const { key, of, with: counts } = sentence(event);
  assert.deepEqual(
    [key, of, counts.accepted, counts.refused, details(event)],
    ['event.servo_ended', { adapter: 'adapter.moves', reason: 'servo.end.silence' }, 7, 0, []],
  );
});

test('changed settings are sentences with their values', () => {
  const of = (event) => sentence({ kind: 'settings', restored: false, ...event });
  const limit = { setting: 'force_limit', force_n: 30 };
  assert.deepEqual(
    [of(limit).key, of({ ...limit, restored: true }).key],
    ['event.setting_changed', 'event.setting_restored'],
  );
  assert.deepEqual([of(limit).fields, details({ kind: 'settings', ...limit })], [['force_n'], []]);
  assert.deepEqual(of({ setting: 'soft_limits', minus_mm: 10, plus_mm: 90 }).fields, ['minus_mm', 'plus_mm']);
  assert.equal(of({ setting: 'overdrive', enabled: false }).key, 'event.setting_off');
  assert.deepEqual(of({ setting: 'tare' }), { key: null, of: { setting: 'setting.tare' } });
});

test('a gap of one column remains beside known ones, however short', () => {
  const samples = new Samples(1000, 2);
  for (let time = 0; time < 1000; time += 1) samples.push(time, [time === 500 ? NaN : 1, 2]);
  const [, broken, whole] = samples.window(0, 1000, 20);
  assert.ok(broken.includes(null) && !whole.includes(null));
  assert.ok(broken.length < 60, `${broken.length} points`);
});

test('flags are read by their bits', () => {
  assert.equal(FLAGS.length, 32);
  assert.equal(FLAGS.filter(({ name }) => name === null).length, 13);
  assert.ok(has(0x1000, 'FAST_STOP') && !has(0x1000, 'MOVING') && !has(null, 'MOVING'));
  assert.ok(FLAGS[20].name === 'SCRIPT_FAILURE' && FLAGS[8].name === 'OVERDRIVE_MODE');
});

test('retries back off up to a limit', () => {
  const delays = Array.from({ length: 20 }, (_, tries) => delay(tries, 0.5));
  assert.ok(delays.every((ms, index) => index === 0 || ms >= delays[index - 1]));
  assert.ok(delays[0] < 300 && delays.at(-1) === 3000);
});

test('acknowledged faults are not called FAST STOPs', () => {
  const key = (fast_stop_id, cleared) => sentence({ kind: 'acknowledge', fast_stop_id, cleared }).key;
  assert.equal(key('019aa5c8', true), 'event.acknowledged');
  assert.equal(key('019aa5c8', false), 'event.not_acknowledged');
  assert.equal(key(null, true), 'event.fault_acknowledged');
  assert.equal(key(null, false), 'event.fault_not_acknowledged');
});
