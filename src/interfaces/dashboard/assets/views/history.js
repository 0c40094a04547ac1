// History of events and motions, from the journal.

import { html, useEffect, useMemo, useRef, useSignal } from '../lib.js';
import { gatewayNow } from '../core/clock.js';
import { ordered } from '../core/newest.js';
import { instant, LATEST } from '../core/times.js';
import { breakable, fullDate, t } from '../model/i18n.js';
import { download } from './export.js';
import { get, query } from '../net/rest.js';
import { evaluate } from '../model/evaluation.js';
import { journalChanges } from '../model/journal.js';
import { grippers, isLive } from '../model/state.js';
import { Curve } from './curve.js';
import { MAX_LINES } from '../ui/plot.js';
import { Numbers } from './numbers.js';
import { Ranges } from './ranges.js';
import { PartReport } from './part.js';
import { Events, Grips } from './tables.js';
import { Choice, Covered, MAX_PART_BYTES, Panel, ProblemNote, Shape, within } from '../ui/parts.js';

const PAGE = 50;
/** On a phone and a tablet, the filters are folded, so that the records are in view. */
const IS_WIDE = matchMedia('(min-width: 1200px)').matches;
const KINDS = {
  events: [
    'command',
    'fast_stop',
    'acknowledge',
    'lease',
    'link',
    'device',
    'settings',
    'refused',
    'gateway',
    'alarm',
    'recipe',
  ],
  grips: ['grip', 'release', 'move', 'home', 'reference'],
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
  'WRONG_PART',
];

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

/** Field for a local time. Empty means no limit. */
function Time({ id, value }) {
  return html`<div class="field"><label for=${id}>${t(`history.${id}`)}</label><input id=${id} type="datetime-local"
      max=${LATEST} value=${value.value} onChange=${({ currentTarget }) => {
        value.value = currentTarget.value;
      }} /></div>`;
}

/** Filters as a text, for the printed report. */
function filterText({ kind, outcome, part_prefix: part, from, to }, what) {
  return [
    kind && t(`${what === 'grips' ? 'command' : 'kind'}.${kind}`),
    outcome && t(`outcome.${outcome}`),
    part && `${t('history.part_prefix')} ${part}`,
    from && `${t('history.from')} ${fullDate(from)}`,
    to && `${t('history.to')} ${fullDate(to)}`,
  ]
    .filter(Boolean)
    .join(', ');
}

export function History({ gripper }) {
  const [what, kind, part, outcome] = [useSignal('grips'), useSignal(''), useSignal(''), useSignal('')];
  const [from, to, isOfAll] = [useSignal(''), useSignal(''), useSignal(false)];
  const range = useSignal(null);
  const [list, next, problem, note] = [useSignal([]), useSignal(null), useSignal(null), useSignal('')];
  const [picked, compares] = [useSignal([]), useSignal(false)];
  const [numbers, shownPart] = [useSignal(null), useSignal(undefined)];
  // Without a kind, the gateway would list only grips.
  const kinds = kind.value || (what.value === 'grips' ? 'all' : '');
  const asked = {
    gripper: isOfAll.value ? '' : gripper.name,
    kind: kinds,
    part_prefix: part.value.trim(),
    outcome: outcome.value,
    from: instant(from.value),
    to: instant(to.value),
  };
  const isWrongTime = asked.from === null || asked.to === null;
  const shown = what.value;
  const address = `${shown}?${query(asked)}`;
  const asking = useMemo(ordered, []);
  /** Addresses of the newest choice and of the records in the list, and the older page that is being read. */
  const [chosen, listed, older] = [useRef(address), useRef(null), useRef(null)];
  chosen.current = address;
  // A list with older pages is not reloaded, so that it stays in place.
  const isKept = () => listed.current === address && (older.current !== null || list.peek().length > PAGE);
  /** Reads the first page of the records, or the page at a cursor, and shows it if it is still wanted. */
  const read = async (cursor, isWanted) => {
    try {
      const page = await get(`${address}&${query({ limit: PAGE, cursor })}`);
      if (!isWanted()) return;
      list.value = cursor ? [...list.peek(), ...page[shown]] : page[shown];
      listed.current = address;
      next.value = page.next_cursor;
      problem.value = null;
    } catch (refused) {
      if (isWanted()) problem.value = refused;
    }
  };
  const load = () => {
    const isNewest = asking();
    // The choice of records can have changed, and is not rendered yet.
    read(null, () => address === chosen.current && shown === what.peek() && !isKept() && isNewest());
  };
  const loadOlder = async () => {
    // Until the first page is there, the list and its cursor belong to an earlier choice.
    if (listed.current !== address || older.current !== null) return;
    const mine = {};
    older.current = mine;
    const isWanted = () => older.current === mine;
    await read(next.peek(), isWanted);
    if (isWanted()) older.current = null;
  };
  useEffect(() => {
    older.current = null;
    numbers.value = null;
  }, [address]);
  useEffect(() => {
    if (isLive.peek() && !isKept() && !isWrongTime) load();
  }, [address, journalChanges.value, isLive.value]);
  const choose = (name) => {
    what.value = name;
    kind.value = '';
    list.value = [];
    listed.current = older.current = null;
  };
  const pick = (grip) => {
    const others = picked.peek().filter(({ id }) => id !== grip.id);
    if (!compares.peek()) picked.value = [grip];
    else if (others.length < picked.peek().length) picked.value = others;
    else picked.value = [...others, grip].slice(-MAX_LINES);
  };
  const attempt = async (act) => {
    try {
      await act();
    } catch (refused) {
      problem.value = refused;
    }
  };
  const save = (isPlain) =>
    attempt(async () => {
      const { count, isAll } = await download(what.peek(), asked, isPlain);
      note.value = t(isAll ? 'history.exported' : 'history.bounded', { count });
    });
  const count = () =>
    attempt(async () => {
      numbers.value = await evaluate(asked);
    });
  const actions = html`<${Choice} label=${t('history.what')} name="records" value=${what.value} onChange=${choose}
      options=${['grips', 'events'].map((name) => [name, t(`history.${name}`)])} /><${Ranges} from=${from} to=${to} chosen=${range} />${
        grippers.value.length > 1 &&
        html`<button type="button" id="of-all" class="quiet" aria-pressed=${isOfAll.value ? 'true' : 'false'}
          onClick=${() => {
            isOfAll.value = !isOfAll.peek();
          }}>${t('all.title')}</button>`
      }<button type="button" id="evaluate" onClick=${count}>${t('numbers.title')}</button><button type="button"
          id="print" onClick=${() => print()}>${t('history.print')}</button><button type="button" id="export"
          onClick=${() => save(false)}>${t('history.export')}</button><button type="button" id="export-plain"
          class="quiet" onClick=${() => save(true)}>${t('history.export_plain')}</button>`;
  const isGrips = what.value === 'grips';
  const reported = isGrips && numbers.value?.parts.find(({ part: id }) => id !== null && id === shownPart.value);
  return html`<${Panel} title=${`${t('nav.history')}: ${isOfAll.value ? t('all.title') : breakable(gripper.name)}`} id="history-title"
      class="report" actions=${actions}>
    <p class="printed">${fullDate(gatewayNow())} ${filterText({ ...asked, kind: kind.value }, what.value)}</p>
    <details class="more filters-place" open=${IS_WIDE}><summary>${t('history.filters')}</summary><div class="filters">
      <${Select} id="kind" label=${t('history.kind')} options=${KINDS[what.value]} value=${kind}
          word=${isGrips ? 'command' : 'kind'} />
      <${Select} id="outcome" label=${t('history.outcome')} options=${OUTCOMES} value=${outcome} word="outcome" />
      <div class="field"><label for="part-filter">${t('history.part_prefix')}</label><input id="part-filter" type="search"
          value=${part.value} onInput=${within(MAX_PART_BYTES, (text) => {
            part.value = text;
          })} /></div>
      <${Time} id="from" value=${from} /><${Time} id="to" value=${to} />
      <span class="small" role="status">${note.value}</span>
    </div></details>
    ${isWrongTime && html`<p class="problem" role="alert"><${Shape} name="high" /> ${t('history.wrong_time')}</p>`}
    <${ProblemNote} problem=${problem} />
    <${Covered}>${numbers.value && html`<${Numbers} numbers=${numbers.value} shown=${shownPart} />`}${
      reported &&
      html`<${PartReport} key=${reported.part} part=${reported} filters=${asked} onCurves=${(grips) => {
        compares.value = true;
        picked.value = grips;
      }} />`
    }<div class=${isGrips ? 'split' : ''}>
      <div class="table-place" tabindex="0" role="region" aria-label=${t(`history.${what.value}`)}>
        ${
          list.value.length === 0
            ? html`<p class="muted nothing">${t('history.none')}
          </p>`
            : isGrips
              ? html`<${Grips} list=${list.value} isOfAll=${isOfAll.value} picked=${picked.value} onPick=${pick} />`
              : html`<${Events}
              list=${list.value} isOfAll=${isOfAll.value} />`
        }
      </div>
      ${isGrips && html`<${Curve} grips=${picked.value} compares=${compares} />`}
    </div>
    ${
      next.value &&
      html`<div><button type="button" id="older" onClick=${loadOlder}>${t('history.more')}</button>
      </div>`
    }</${Covered}>
  </${Panel}>`;
}
