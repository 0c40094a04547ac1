// Completeness of the texts: every language has a text for every code, flag, state and outcome of the API.

import assert from 'node:assert/strict';
import { readdirSync, readFileSync } from 'node:fs';
import { test } from 'node:test';

import { ASSETS } from './harness.mjs';

const { de } = await import(`${ASSETS}locales/de.js`);
const { en } = await import(`${ASSETS}locales/en.js`);
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

test('every text used by a module exists', () => {
  const asked = sources.flatMap(({ path, text }) =>
    Array.from(text.matchAll(/\bt\((?:[^()'`]*\? )?'([\w.]+)'(?: : '([\w.]+)')?/g), ([, one, other]) => [one, other])
      .flat()
      .filter(Boolean)
      .map((key) => ({ path, key })),
  );
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
  const isAsked = (key) => all.includes(`'${key}'`) || [...families].some((family) => key.startsWith(family));
  assert.deepEqual(
    Object.keys(en).filter((key) => !isAsked(key)),
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
    'request_id_reused',
  ];
  const needed = [
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
