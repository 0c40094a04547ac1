// The strip below the bar: one sentence with its buttons, of always the same height, so that no notice moves the page.
// Further notices are in a list that a button opens.

import { html, signal, useEffect, useRef } from '../lib.js';
import { t } from '../model/i18n.js';
import { Shape } from './parts.js';

/**
 * Functions that return notices, most urgent first by `rank`: `{key, rank, kind, tone, shape, role, text, buttons}`, and
 * `close` with `closeLabel` for a notice that a person can close.
 */
const sources = signal([]);

/** Adds a source of notices. */
export function addNotices(source) {
  sources.value = [...sources.peek(), source];
}

/** Whether the list of all notices is open. */
const isOpen = signal(false);

/** Time within which a person cannot react to a new notice. */
const REACTS_AFTER_MS = 500;

function Notice({ notice, hasButtons }) {
  const { kind, tone, shape, role = 'status', text, title, buttons, close, closeLabel, closeName, isStop } = notice;
  return html`<div class=${`notice ${tone ?? ''} ${isStop ? 'stopped' : ''}`} data-notice=${kind} role=${role}>
    <${Shape} name=${shape ?? 'off'} />
    <p title=${title}>${text}</p>
    ${
      hasButtons &&
      (buttons || close) &&
      html`<div class="buttons">${buttons}${
        close &&
        html`<button type="button" class="quiet notice-close" aria-label=${`${closeLabel}: ${closeName}`}
            title=${closeLabel} onClick=${close}>×</button>`
      }</div>`
    }</div>`;
}

export function Strip() {
  const place = useRef(null);
  const all = sources.value.flatMap((source) => source()).sort((a, b) => a.rank - b.rank);
  const [first] = all;
  const shown = first?.key ?? '';
  useEffect(() => {
    // A tap that was aimed at the notice before does nothing.
    place.current.dataset.fresh = '';
    const timer = setTimeout(() => delete place.current?.dataset.fresh, REACTS_AFTER_MS);
    return () => clearTimeout(timer);
  }, [shown]);
  const others = Math.max(0, all.length - 1);
  // On a phone, the buttons of the first notice are in the list too.
  const hasMore = others > 0 || Boolean(first?.buttons || first?.close);
  const isListed = isOpen.value && hasMore;
  return html`<section class="strip" ref=${place} aria-label=${t('notice.label')}>
    ${first && html`<${Notice} key=${first.key} notice=${first} hasButtons=${!isListed} />`}
    ${
      hasMore &&
      html`<button type="button" id="notices-more" class=${`quiet ${others > 0 ? '' : 'for-phone'}`}
          aria-expanded=${isListed ? 'true' : 'false'} aria-label=${`${others > 0 ? `+${others}` : ''} ${t('notice.others', { count: others })}`.trim()} onClick=${() => {
            isOpen.value = !isOpen.peek();
          }}>${others > 0 ? `+${others}` : '⋯'}</button>`
    }
    ${
      isListed &&
      html`<div class="strip-list">${all.map(
        (notice) => html`<${Notice} key=${notice.key} notice=${notice} hasButtons=${true} />`,
      )}</div>`
    }
  </section>`;
}
