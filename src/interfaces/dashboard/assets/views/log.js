// The communication log: decoded frames, their bytes on demand, and a command editor.

import { html, signal, useEffect, useRef, useSignal } from '../lib.js';
import { interpretations, parseId } from '../core/bytes_text.js';
import { save } from './export.js';
import { fromHex, toHex } from '../core/frame.js';
import { breakable, t } from '../model/i18n.js';
import { clear, follow, frames, hasUpdates, isPaused } from '../model/frames.js';
import { Editor } from './editor.js';
import { Choice, Covered, Panel } from '../ui/parts.js';

const two = (value) => String(value).padStart(2, '0');

/** Local time of day, with a fixed width. */
const clock = (at) =>
  `${[at.getHours(), at.getMinutes(), at.getSeconds()].map(two).join(':')}.${String(at.getMilliseconds()).padStart(3, '0')}`;

const day = (at) => [at.getFullYear(), two(at.getMonth() + 1), two(at.getDate())].join('-');

/** Text filter, and `sent`, `received` or an empty direction. */
const filter = signal('');
const direction = signal('');

/** Whether a frame has all words of the filter: in its text, as its id, or in its bytes. */
function fits(frame) {
  if (direction.value !== '' && frame.direction !== direction.value) return false;
  const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
  const text = `${frame.text.toLowerCase()} ${frame.hex}`;
  return words.every((word) => text.includes(word) || parseId(word) === frame.id);
}

/** Rows that fit the filter. Rows about missing frames always do; folded updates are hidden by a filter. */
function shownRows() {
  const isFiltered = filter.value.trim() !== '' || direction.value !== '';
  return frames.value.filter((row) =>
    isFrame(row) ? fits(row) : !(isFiltered && ['updates', 'away'].includes(row.direction)),
  );
}

const isFrame = (row) => row.text !== undefined;

const noteOf = ({ direction: kind, count }) => t(`log.${kind}`, { count });

function asText(rows) {
  const lines = rows.map((row) => {
    const at = new Date(row.at);
    const what = isFrame(row)
      ? `${row.direction === 'sent' ? '->' : '<-'} ${toHex(fromHex(row.hex), ' ')}  ${row.text}`
      : `-- ${noteOf(row)}`;
    return `${day(at)} ${clock(at)} ${what}\n`;
  });
  return lines.join('');
}

/** Copies a text. On a page without TLS, browsers allow this only for a selection. */
async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = document.createElement('textarea');
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand('copy');
    area.remove();
  }
}

function Row({ frame, picked, withHex }) {
  if (!isFrame(frame))
    return html`<p class=${`frame-note ${['gap', 'lost'].includes(frame.direction) ? 'tone-high' : ''}`}
      data-row=${frame.direction}>${noteOf(frame)}</p>`;
  return html`<button type="button" class=${`frame ${frame.direction} ${frame.damage ? 'tone-high' : ''}`} data-damage=${frame.damage}
      aria-pressed=${picked.value?.seq === frame.seq ? 'true' : 'false'} onClick=${() => {
        picked.value = frame;
      }}>
    <span class="muted">${clock(new Date(frame.at))}</span><span>${frame.direction === 'sent' ? '→' : '←'}</span><span
        class="text">${frame.text}</span>
    ${withHex && html`<span class="hex">${toHex(fromHex(frame.hex), ' ')}</span>`}</button>`;
}

const partOf = (index, length) =>
  index < 3 ? 'preamble' : index === 3 ? 'id' : index < 6 ? 'size' : index >= length - 2 ? 'checksum' : 'payload';

/** Bytes of a frame, selected one by one, or as a range with Shift. */
export function Bytes({ bytes }) {
  const range = useSignal(null);
  useEffect(() => {
    range.value = null;
  }, [toHex(bytes)]);
  const pick = (index) => (event) => {
    const from = event.shiftKey && range.value ? range.value.anchor : index;
    range.value = { anchor: from, first: Math.min(from, index), last: Math.max(from, index) };
  };
  const step = (index) => (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const next = by && event.currentTarget.parentElement.children[index + by];
    if (!next) return;
    event.preventDefault();
    next.focus();
    if (event.shiftKey) pick(index + by)(event);
  };
  const isPicked = (index) => range.value !== null && index >= range.value.first && index <= range.value.last;
  const chosen = range.value === null ? null : Array.from(bytes.slice(range.value.first, range.value.last + 1));
  return html`<div class="bytes" role="group" aria-label=${t('log.frame')}>
      ${Array.from(
        bytes,
        (byte, index) => html`<button type="button" key=${index} class=${`byte ${partOf(
          index,
          bytes.length,
        )}`} aria-pressed=${isPicked(index) ? 'true' : 'false'} title=${t(
          `log.part.${partOf(index, bytes.length)}`,
        )} aria-label=${t('log.byte', { index, hex: toHex([byte]) })} onClick=${pick(index)}
                  onKeyDown=${step(index)}>${toHex([byte])}</button>`,
      )}
    </div>
    ${
      chosen === null
        ? html`<p class="hint">${t('log.select')}</p>`
        : html`<dl class="meanings"
        id="meanings">${interpretations(chosen).map(
          ({ type, value }) => html`<dt key=${type}>${t(`type.${type}`)}
          </dt><dd data-type=${type}>${String(value)}</dd>`,
        )}</dl>`
    }`;
}

export function Log({ gripper }) {
  const picked = useSignal(null);
  const withHex = useSignal(false);
  const note = useSignal('');
  const place = useRef(null);
  useEffect(() => follow(gripper.name), [gripper]);
  const rows = shownRows();
  const isAtEnd =
    place.current === null || place.current.scrollHeight - place.current.scrollTop - place.current.clientHeight < 40;
  useEffect(() => {
    if (isAtEnd && place.current) place.current.scrollTop = place.current.scrollHeight;
  }, [rows.length, rows.at(-1)]);
  const toggle = (id, state, label) => html`<button type="button" id=${id} class="quiet"
      aria-pressed=${state.value ? 'true' : 'false'} onClick=${() => {
        state.value = !state.peek();
      }}>${label}
        </button>`;
  const actions = html`${toggle('with-hex', withHex, t('log.hex'))}${toggle(
    'with-updates',
    hasUpdates,
    t('log.with_updates'),
  )}${toggle('pause-log', isPaused, t(isPaused.value ? 'log.resume' : 'log.pause'))}<button
          type="button" class="quiet" onClick=${clear}>${t('log.clear')}</button><button type="button" id="copy-log"
          class="quiet" onClick=${async () => {
            await copy(asText(rows));
            note.value = t('log.copied', { count: rows.length });
          }}>${t('log.copy')}</button><button type="button" id="save-log" class="quiet" onClick=${() =>
            save(`${gripper.name}-frames.txt`, asText(rows), 'text/plain')}>${t('log.save')}</button>`;
  return html`<div class="split">
    <${Panel} title=${`${t('log.title')}: ${breakable(gripper.name)}`} id="log-title" actions=${actions}>
      <div class="filters">
        <div class="field"><label for="log-filter">${t('log.filter')}</label><input id="log-filter" type="search"
            placeholder=${t('log.filter_hint')} value=${filter.value} onInput=${({ currentTarget }) => {
              filter.value = currentTarget.value;
            }} /></div>
        <${Choice} label=${t('log.direction')} name="direction" value=${direction.value} onChange=${(chosen) => {
          direction.value = chosen;
        }} options=${['', 'sent', 'received'].map((kind) => [kind, t(`log.only_${kind || 'both'}`)])} />
        <span class="small" role="status">${note.value}</span>
      </div>
      <${Covered} gripper=${gripper}><div class="frames" ref=${place} tabindex="0" role="region" aria-label=${t('log.title')}>
        ${
          rows.length === 0
            ? html`<p class="muted nothing">${t(frames.value.length === 0 ? 'log.none' : 'log.none_fits')}
          </p>`
            : rows.map(
                (frame) => html`<${Row} key=${frame.seq} frame=${frame} picked=${picked}
              withHex=${withHex.value} />`,
              )
        }
      </div></${Covered}>
    </${Panel}>
    <div class="column">
      <${Panel} title=${t('log.frame')} id="frame-title">
        ${
          picked.value
            ? html`<p><code>${picked.value.text}</code></p><${Bytes}
            bytes=${fromHex(picked.value.hex)} />`
            : html`<p class="muted">${t('log.pick')}</p>`
        }
      </${Panel}>
      <${Editor} gripper=${gripper} />
    </div>
  </div>`;
}
