// Completeness of the texts: every language has a text for every code, flag, state and outcome of the API.

import assert from 'node:assert/strict';
import { readdirSync, readFileSync } from 'node:fs';
import { test } from 'node:test';

import { ASSETS, textsOf } from './harness.mjs';

const [de, en] = await Promise.all(['de', 'en'].map(textsOf));
const { en: enFirst } = await import(`${ASSETS}locales/en.js`);
const { placeholders } = await import(`${ASSETS}core/words.js`);
const { FLAGS } = await import(`${ASSETS}core/flags.js`);

const api = JSON.parse(readFileSync(new URL('../../openapi/openapi.json', import.meta.url)));
const sources = readdirSync(ASSETS, { recursive: true })
  .filter((path) => path.endsWith('.js') && !path.startsWith('vendor') && !path.startsWith('locales'))
  .map((path) => ({ path, text: readFileSync(ASSETS + path, 'utf8') }));

test('every language has the same texts, with the same parameters', () => {
  assert.deepEqual(Object.keys(de).sort(), Object.keys(en).sort());
  for (const key of Object.keys(en)) {
    assert.deepEqual(placeholders(de[key]), placeholders(en[key]), key);
    assert.ok(de[key].trim() !== '' && en[key].trim() !== '', key);
  }
});

const USES = /\bt\((?:[^()'`]*\? )?'([\w.]+)'(?: : '([\w.]+)')?/g;

/** Texts that modules use, each with its module. */
const asked = sources.flatMap(({ path, text }) =>
  Array.from(text.matchAll(USES), ([, one, other]) => [one, other])
    .flat()
    .filter(Boolean)
    .map((key) => ({ path, key })),
);

/** Adds a module, and all that it imports before it runs. */
function addImports(path, found) {
  if (found.has(path)) return found;
  found.add(path);
  const { text } = sources.find((one) => one.path === path) ?? { text: '' };
  for (const [, from] of text.matchAll(/ from '([^']+)';/g))
    addImports(new URL(from, `file:///${path}`).pathname.slice(1), found);
  return found;
}

test('the first screen has its texts', () => {
  const first = addImports('app.js', new Set());
  const wanted = asked.filter(({ path }) => first.has(path));
  assert.ok(wanted.length > 30 && wanted.length < asked.length / 2, `${wanted.length} found`);
  assert.deepEqual(
    wanted.filter(({ key }) => !(key in enFirst)),
    [],
  );
});

test('every text used by a module exists', () => {
  assert.ok(asked.length > 150, `only ${asked.length} found`);
  assert.deepEqual(
    asked.filter(({ key }) => !(key in en)),
    [],
  );
});

test('every text is used', () => {
  const all = sources.map(({ text }) => text).join('\n');
  const families = new Set(Array.from(all.matchAll(/`([\w.]+\.)\$\{/g), ([, family]) => family));
  for (const family of ['history.', 'type.', 'command.', 'kind.', 'outcome.']) families.add(family);
  const isMotionRequested = (key) => all.includes(`'${key}'`) || [...families].some((family) => key.startsWith(family));
  assert.deepEqual(
    Object.keys(en).filter((key) => !isMotionRequested(key)),
    [],
  );
});

test('every value of the API has a text', () => {
  const { schemas } = api.components;
  const words = (family, name) => {
    const values = schemas[name].enum ?? schemas[name].oneOf.flatMap((one) => one.enum);
    assert.ok(values.length > 1, name);
    return values.map((value) => `${family}.${value}`);
  };
  // These codes concern programs whose requests this page never sends.
  const noneOfOurs = [
    'foreign_host',
    'foreign_origin',
    'method_not_allowed',
    'request_timeout',
    'too_large',
    'unsupported_encoding',
    'request_id_reused',
  ];
  const valuesOf = (family, name, field) => {
    const values = schemas[name].properties[field].enum;
    assert.ok(values.length > 1, name);
    return values.map((value) => `${family}.${value}`);
  };
  const needed = [
    ...valuesOf('event', 'GatewayEvent', 'event'),
    ...valuesOf('event', 'DeviceEvent', 'event'),
    ...valuesOf('setting', 'SettingsEvent', 'setting'),
    ...words('problem', 'Code').filter((key) => !noneOfOurs.includes(key.slice('problem.'.length))),
    ...words('outcome', 'Outcome'),
    ...words('command', 'Kind'),
    ...words('cause', 'FastStopCause'),
    ...words('link', 'Link'),
    ...words('loss', 'OnLossMoving'),
    ...words('loss', 'OnLossHolding'),
    ...words('event', 'LeaseStep'),
    ...words('event', 'FastStopStep'),
    ...words('kind', 'EventKind'),
    ...words('event.alarm', 'AlarmStep'),
    ...words('adapter', 'ServoAdapter'),
    ...words('servo.end', 'ServoEnd'),
    ...words('door', 'Door'),
    ...FLAGS.filter(({ name }) => name).map(({ name }) => `flag.${name}`),
    ...words('alarm', 'AlarmKind'),
    ...['IDLE', 'GRASPING', 'NO_PART', 'PART_LOST', 'HOLDING', 'RELEASING', 'POSITIONING', 'ERROR'].map(
      (state) => `state.${state}`,
    ),
  ];
  assert.deepEqual(
    needed.filter((key) => !(key in en)),
    [],
  );
});
