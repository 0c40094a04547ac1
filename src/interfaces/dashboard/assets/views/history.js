// History of events and motions, from the journal.

import { html, useEffect, useMemo, useSignal } from '../lib.js';
import { numbered } from '../core/newest.js';
import { details, sentence } from './sentence.js';
import { fixed, moment, plain, t } from '../model/i18n.js';
import { download } from './export.js';
import { get, query } from '../net/rest.js';
import { eventSeq, isLive } from '../model/store.js';
import { Curve } from './curve.js';
import { Choice, Covered, MAX_PART_BYTES, Panel, ProblemNote, within } from '../ui/parts.js';

const PAGE = 50;
/** Delay of a reload after an event, because events come in bursts. */
const LOOKS_AFTER_MS = 400;
const KINDS = {
  events: ['command', 'fast_stop', 'acknowledge', 'lease', 'link', 'device', 'settings', 'refused', 'gateway'],
  grips: ['grip', 'release', 'move', 'home'],
};
const OUTCOMES = [
  'SUCCESS',
  'PART_HELD',
  'NO_PART',
  'BLOCKED',
  'ABORTED',
  'RANGE',
  'TIMEOUT',
  'FAILED',
  'REFUSED',
  'UNKNOWN',
];
const BAD = ['NO_PART', 'BLOCKED', 'RANGE', 'TIMEOUT', 'FAILED', 'REFUSED', 'UNKNOWN', 'ABORTED'];

function textOf(event) {
  const { key, of = {}, with: values = {} } = sentence(event);
  const words = Object.fromEntries(Object.entries(of).map(([name, word]) => [name, t(word)]));
  if (key) return t(key, { ...words, ...values });
  return Object.values(words).join(': ') || event.kind;
}

const value = (one) => (typeof one === 'number' ? plain(one) : String(one));

const NUMBERS = ['width', 'history.peak', 'history.contact', 'history.duration'];

function Events({ list }) {
  return html`<table><thead><tr>${['history.at', 'history.kind', 'history.details', 'history.who'].map(
    (key) => html`<th scope="col" key=${key}>${t(key)}</th>`,
  )}</tr></thead>
    <tbody>${list.map(
      (event) => html`<tr key=${event.seq}
        class=${event.kind === 'fast_stop' ? 'stop-row' : event.kind === 'refused' || BAD.includes(event.outcome) ? 'bad' : ''}>
      <td>${moment(event.at)}</td><td>${t(`kind.${event.kind}`)}</td>
      <td class="wide">${textOf(event)} <span class="muted small">${details(event)
        .map(([field, given]) => `${field} ${value(given)}`)
        .join(', ')}</span></td><td>${event.subject ?? ''}</td></tr>`,
    )}
            </tbody></table>`;
}

function Grips({ list, picked }) {
  const columns = [
    'history.at',
    'history.kind',
    'history.outcome',
    'history.part',
    'width',
    'history.peak',
    'history.contact',
    'history.duration',
    'history.curve',
  ];
  return html`<table><thead><tr>${columns.map(
    (key) => html`<th scope="col" key=${key}
      class=${NUMBERS.includes(key) ? 'number' : ''}>${t(key)}</th>`,
  )}</tr></thead>
    <tbody>${list.map(
      (grip) => html`<tr key=${grip.id}
        aria-selected=${picked.value?.id === grip.id ? 'true' : 'false'}
            class=${BAD.includes(grip.outcome) || grip.part_lost_at ? 'bad' : ''}>
      <td>${moment(grip.started_at)}</td><td>${t(`command.${grip.kind}`)}</td>
        <td>${t(`outcome.${grip.outcome}`)}${grip.part_lost_at ? `, ${t('event.part_lost')}` : ''}</td>
          <td>${grip.part_id ?? '–'}</td>
      <td class="number">${fixed(grip.width_mm, 2)} mm</td><td class="number">${fixed(grip.peak_force_n, 1)} N</td><td
          class="number">${grip.contact_width_mm == null ? '–' : `${fixed(grip.contact_width_mm, 2)} mm`}</td><td
              class="number">${grip.duration_ms == null ? '–' : `${fixed(grip.duration_ms / 1000, 2)} s`}</td>
      <td><button type="button" class="quiet" aria-pressed=${picked.value?.id === grip.id ? 'true' : 'false'}
          onClick=${() => {
            picked.value = grip;
          }}>${t('history.curve')}</button></td></tr>`,
    )}</tbody></table>`;
}

function Select({ id, label, options, value: chosen, word }) {
  return html`<div class="field"><label for=${id}>${label}</label><select id=${id} value=${chosen.value}
      onChange=${(event) => {
        chosen.value = event.currentTarget.value;
      }}>
    <option value="">${t('history.all')}</option>${options.map(
      (option) => html`<option key=${option}
        value=${option}>${t(`${word}.${option}`)}</option>`,
    )}</select></div>`;
}

export function History({ one }) {
  const [what, kind, part, outcome] = [useSignal('grips'), useSignal(''), useSignal(''), useSignal('')];
  const [list, next, problem, picked, note] = [
    useSignal([]),
    useSignal(null),
    useSignal(null),
    useSignal(null),
    useSignal(''),
  ];
  // Without a kind, the gateway would list grips alone.
  const kinds = kind.value || (what.value === 'grips' ? 'all' : '');
  const asked = { gripper: one.name, kind: kinds, part_id: part.value.trim(), outcome: outcome.value };
  const address = `${what.value}?${query(asked)}`;
  const asking = useMemo(numbered, []);
  const load = async (cursor = null) => {
    const isNewest = asking();
    try {
      const page = await get(`${address}&${query({ limit: PAGE, cursor })}`);
      if (!isNewest()) return;
      list.value = cursor ? [...list.peek(), ...page[what.peek()]] : page[what.peek()];
      next.value = page.next_cursor;
      problem.value = null;
    } catch (refused) {
      if (isNewest()) problem.value = refused;
    }
  };
  useEffect(() => {
    // A list with older pages is not reloaded, so that it stays in place.
    if (!isLive.peek() || list.peek().length > PAGE) return undefined;
    const timer = setTimeout(load, LOOKS_AFTER_MS);
    return () => clearTimeout(timer);
  }, [eventSeq.value, address]);
  useEffect(() => {
    load();
  }, [address, isLive.value]);
  const choose = (name) => {
    what.value = name;
    kind.value = '';
    list.value = [];
  };
  const save = async () => {
    try {
      const { count, isAll } = await download(what.peek(), asked);
      note.value = t(isAll ? 'history.exported' : 'history.bounded', { count });
    } catch (refused) {
      problem.value = refused;
    }
  };
  const actions = html`<${Choice} label=${t('history.what')} name="records" value=${what.value} onChange=${choose}
      options=${['grips', 'events'].map((name) => [name, t(`history.${name}`)])} /><button type="button" id="export"
          onClick=${save}>${t('history.export')}</button>`;
  return html`<${Panel} title=${`${t('nav.history')}: ${one.name}`} id="history-title" actions=${actions}>
    <div class="filters">
      <${Select} id="kind" label=${t('history.kind')} options=${KINDS[what.value]} value=${kind}
          word=${what.value === 'grips' ? 'command' : 'kind'} />
      <${Select} id="outcome" label=${t('history.outcome')} options=${OUTCOMES} value=${outcome} word="outcome" />
      <div class="field"><label for="part-filter">${t('history.part')}</label><input id="part-filter" type="search"
          value=${part.value} onInput=${within(MAX_PART_BYTES, (text) => {
            part.value = text;
          })} /></div>
      <span class="small" role="status">${note.value}</span>
    </div>
    <${ProblemNote} problem=${problem} />
    <${Covered}><div class=${what.value === 'grips' ? 'split' : ''}>
      <div class="table-place" tabindex="0" role="region" aria-label=${t(`history.${what.value}`)}>
        ${
          list.value.length === 0
            ? html`<p class="muted nothing">${t('history.none')}
          </p>`
            : what.value === 'grips'
              ? html`<${Grips} list=${list.value} picked=${picked} />`
              : html`<${Events}
              list=${list.value} />`
        }
      </div>
      ${what.value === 'grips' && html`<${Curve} grip=${picked.value} />`}
    </div>
    ${
      next.value &&
      html`<div><button type="button" onClick=${() => load(next.peek())}>${t('history.more')}</button>
      </div>`
    }</${Covered}>
  </${Panel}>`;
}
