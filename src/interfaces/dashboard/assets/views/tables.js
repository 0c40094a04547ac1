// Tables of the history: events in words, and motions.

import { html } from '../lib.js';
import { isJog, isJogDone } from '../core/jogs.js';
import { nameIn, person } from '../core/people.js';
import { alarmName } from '../ui/alarm.js';
import { details, sentence } from '../core/sentence.js';
import { fixed, moment, ofProblem, plain, t } from '../model/i18n.js';
import { valueNames } from '../ui/unknown.js';

const BAD = ['NO_PART', 'BLOCKED', 'RANGE', 'TIMEOUT', 'FAILED', 'REFUSED', 'UNKNOWN', 'ABORTED', 'WRONG_PART'];

/** Operations whose names have translations. */
const MOTIONS = ['home', 'move', 'grip', 'release', 'stop'];

/** Keys of the texts for values that are words of the API. */
const WORDS = {
  direction: (given) => t(`direction.${given}`),
  effect: (given) => t(`effect.${given}`),
};

const UNITS = { mm: 'mm', s: 'mm/s', n: 'N', s2: 'mm/s²' };

function valueText(field, given) {
  if (field in WORDS) return WORDS[field](given);
  const unit = UNITS[field.split('_').at(-1)] ?? '';
  return typeof given === 'number' ? `${plain(given)} ${unit}`.trim() : String(given);
}

/** The event as a sentence. A refusal is described by its code, in the user's language. */
function textOf(event) {
  const { key, of = {}, with: parameters = {}, flags, values, fields } = sentence(event);
  const words = Object.fromEntries(Object.entries(of).map(([name, word]) => [name, t(word)]));
  if (flags) words.flags = flags.map((flag) => t(`flag.${flag}`)).join(', ');
  if (values) words.values = valueNames(values);
  if (fields) words.value = fields.map((field) => valueText(field, event[field])).join(t('event.setting_range'));
  if (event.kind === 'alarm') words.alarm = alarmName({ ...event, gripper: null });
  if (event.kind === 'refused') words.cause = ofProblem({ ...event, detail: event.cause });
  if (event.kind === 'refused' && MOTIONS.includes(event.command)) words.command = t(`command.${event.command}`);
  if (key) return t(key, { ...parameters, ...words });
  return Object.values(words).join(': ') || t(`kind.${event.kind}`);
}

/** The client of an event. A command's holder is the name of its user. */
function whoText({ kind, subject, label, reason, holder }) {
  return subject ? person(subject, label, nameIn(reason), kind === 'command' ? holder : null) : '';
}

const NUMBERS = ['width', 'history.peak', 'history.contact', 'history.duration'];

const Head = ({ columns }) =>
  html`<thead><tr>${columns.map(
    (key) => html`<th scope="col" key=${key} class=${NUMBERS.includes(key) ? 'number' : ''}>${t(key)}</th>`,
  )}</tr></thead>`;

export function Events({ list, isOfAll }) {
  const columns = ['history.at', ...(isOfAll ? ['all.gripper'] : []), 'history.kind', 'history.details', 'history.who'];
  return html`<table><${Head} columns=${columns} />
    <tbody>${list.map(
      (event) => html`<tr key=${event.seq}
        class=${event.kind === 'fast_stop' ? 'stop-row' : event.kind === 'refused' || BAD.includes(event.outcome) ? 'bad' : ''}>
      <td>${moment(event.at)}</td>${isOfAll && html`<td>${event.gripper ?? '–'}</td>`}<td>${t(`kind.${event.kind}`)}</td>
      <td class="wide">${textOf(event)} <span class="muted small">${details(event)
        .map(([field, given]) => `${t(`detail.${field}`)} ${valueText(field, given)}`)
        .join(', ')}</span></td><td>${whoText(event)}</td></tr>`,
    )}
            </tbody></table>`;
}

/** Whether a motion has gone wrong. The end of a jog is not a failure. */
const isBad = (grip) => (BAD.includes(grip.outcome) && !isJogDone(grip)) || Boolean(grip.part_lost_at);

/** The outcome of a motion, with the reason of a failure. */
function outcomeText(grip) {
  if (isJogDone(grip)) return t('outcome.jog');
  const lost = grip.part_lost_at ? `, ${t('event.part_lost')}` : '';
  const why = grip.code ? `: ${ofProblem(grip)}` : '';
  return `${t(`outcome.${grip.outcome}`)}${lost}${why}`;
}

/** The client of a motion, by the name under which it had control. */
const gripWho = ({ subject, holder }) => person(subject, holder);

/** A number with its unit, or a dash if it is unknown. */
const measured = (value, decimals, unit) => (value == null ? '–' : `${fixed(value, decimals)} ${unit}`);

/** `picked` has the grips whose curves are shown, and `onPick` takes another one. */
export function Grips({ list, isOfAll, picked, onPick }) {
  const columns = [
    'history.at',
    ...(isOfAll ? ['all.gripper'] : []),
    'history.kind',
    'history.outcome',
    'history.part',
    'width',
    'history.peak',
    'history.contact',
    'history.duration',
    'history.who',
    'history.curve',
  ];
  const isPicked = (grip) => (picked.some(({ id }) => id === grip.id) ? 'true' : 'false');
  return html`<table><${Head} columns=${columns} />
    <tbody>${list.map(
      (grip) => html`<tr key=${grip.id} aria-selected=${isPicked(grip)}
            class=${isBad(grip) ? 'bad' : ''}>
      <td>${moment(grip.started_at)}</td>${isOfAll && html`<td>${grip.gripper}</td>`}<td>${t(isJog(grip) ? 'jog.title' : `command.${grip.kind}`)}</td>
        <td>${outcomeText(grip)}</td>
          <td>${grip.part_id ?? '–'}</td>
      <td class="number">${measured(grip.width_mm, 2, 'mm')}</td>
      <td class="number">${measured(grip.peak_force_n, 1, 'N')}</td>
      <td class="number">${measured(grip.contact_width_mm, 2, 'mm')}</td>
      <td class="number">${grip.duration_ms == null ? '–' : `${fixed(grip.duration_ms / 1000, 2)} s`}</td>
      <td>${gripWho(grip)}</td>
      <td><button type="button" class="quiet" aria-pressed=${isPicked(grip)} aria-label=${`${t('history.curve')}: ${
        grip.gripper
      }, ${t(`command.${grip.kind}`)}, ${moment(grip.started_at)}`}
          onClick=${() => onPick(grip)}>${t('history.curve')}</button></td></tr>`,
    )}</tbody></table>`;
}
