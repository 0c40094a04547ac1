// The communication log: decoded frames, their bytes on demand, and a command editor.

import { html, useEffect, useRef, useSignal } from '../lib.js';
import { interpretations } from './bytes.js';
import { fromHex, toHex } from './frame.js';
import { t } from '../model/i18n.js';
import { clear, follow, frames, hasUpdates, isPaused } from './frames.js';
import { Editor } from './editor.js';
import { Covered, Panel } from '../ui/parts.js';

/** Time of day in UTC, with a fixed width. */
const clock = (at) => new Date(at).toISOString().slice(11, 23);

function Row({ frame, picked, withHex }) {
  if (frame.direction === 'gap')
    return html`<p class="frame tone-high">${t('log.missed', { count: frame.missed })}
    </p>`;
  return html`<button type="button" class=${`frame ${frame.direction}`}
      aria-pressed=${picked.value?.seq === frame.seq ? 'true' : 'false'} onClick=${() => {
        picked.value = frame;
      }}>
    <span class="muted">${clock(frame.at)}</span><span>${frame.direction === 'sent' ? '→' : '←'}</span><span
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

export function Log({ one }) {
  const picked = useSignal(null);
  const withHex = useSignal(false);
  const place = useRef(null);
  useEffect(() => follow(one.name), [one]);
  const isAtEnd =
    place.current === null || place.current.scrollHeight - place.current.scrollTop - place.current.clientHeight < 40;
  useEffect(() => {
    if (isAtEnd && place.current) place.current.scrollTop = place.current.scrollHeight;
  }, [frames.value]);
  const toggle = (id, state, label) => html`<button type="button" id=${id} class="quiet"
      aria-pressed=${state.value ? 'true' : 'false'} onClick=${() => {
        state.value = !state.peek();
      }}>${label}
        </button>`;
  const actions = html`${toggle('with-hex', withHex, t('log.hex'))}${toggle(
    'with-updates',
    hasUpdates,
    t('log.updates'),
  )}${toggle('pause-log', isPaused, t(isPaused.value ? 'log.resume' : 'log.pause'))}<button
          type="button" class="quiet" onClick=${clear}>${t('log.clear')}</button>`;
  return html`<div class="split">
    <${Panel} title=${`${t('log.title')}: ${one.name}`} id="log-title" actions=${actions}>
      <${Covered} one=${one}><div class="frames" ref=${place} tabindex="0" role="region" aria-label=${t('log.title')}>
        ${
          frames.value.length === 0
            ? html`<p class="muted nothing">${t('log.none')}
          </p>`
            : frames.value.map(
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
      <${Editor} one=${one} />
    </div>
  </div>`;
}
