// All grippers at a glance, and the fleet if there is one.

import { html, useEffect } from '../lib.js';
import { numbered } from '../core/newest.js';
import { fixed, plain, span, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { fleet, grippers, hasOthers, isLive, selected } from '../model/store.js';
import { onPress, Panel, Shape, shapeOf, whyOld } from '../ui/parts.js';
import { go } from '../ui/route.js';
import { stopFleet } from '../ui/stop.js';
import { missingText, Unknown, unknownText } from '../ui/unknown.js';

const ASKED_EVERY_MS = 2000;

const asking = numbered();

async function askFleet() {
  if (!isLive.peek() || document.hidden) return;
  const isNewest = asking();
  try {
    const { grippers: all } = await get('fleet');
    if (isNewest()) fleet.value = all;
  } catch {
    // Tried again with the next poll.
  }
}

function Gauge({ one }) {
  const stroke = one.info.value?.stroke_mm ?? 110;
  const width = one.width.value;
  const gap = (width / stroke) * 200;
  return html`<svg class="gauge" viewBox="0 0 200 14" preserveAspectRatio="none" aria-hidden="true"><rect
      class="track" width="200" height="14" rx="2" />${
        width !== null && html`<rect class="gap" x=${(100 - gap / 2).toFixed(1)} width=${gap.toFixed(1)} height="14" />`
      }</svg>`;
}

/** Values of a tile: name, decimals and unit. */
const FIGURES = [
  ['width_mm', 1, 'mm'],
  ['speed_mm_s', 0, 'mm/s'],
  ['force_n', 1, 'N'],
];

function Figures({ state }) {
  return html`<span class="tile-figures">${FIGURES.map(([name, decimals, unit]) => {
    const why = unknownText(state, name);
    return html`<span key=${name}>${why ? html`<${Unknown} why=${why} />` : html`${fixed(state[name], decimals)}<span class="unit">${unit}</span>`}</span>`;
  })}</span>`;
}

function controlText(one) {
  if (one.reservedFor.value) return t('bar.reserved', { name: one.reservedFor.value });
  return one.holder.value ? t('all.control', { holder: one.holder.value }) : t('all.no_control');
}

function Tile({ one }) {
  const old = whyOld(one);
  const isLatched = one.latchId.value !== null;
  const state = one.condition.value ?? 'unknown';
  const tone = old || state === 'PART_LOST' ? 'tone-high' : isLatched || state === 'ERROR' ? 'tone-critical' : '';
  const why = missingText(one) ?? unknownText(one.state.value, 'width_mm');
  return html`<button type="button" class="tile" data-gripper=${one.name}
      onClick=${() => {
        selected.value = one.name;
        go('operate');
      }}>
    <span class="tile-head"><span>${one.name}</span><span class=${`tile-state ${tone}`}><${Shape}
        name=${shapeOf(one)} />${old ? old.text : t(`state.${state}`)}</span></span>
    ${
      old
        ? html`<span class="muted small">${old.detail ?? ''}</span>`
        : html`<${Gauge} one=${one} />
      <${Figures} state=${one.state.value} />${why && html`<span class="small">${why}</span>`}`
    }
    <span class="muted small">${whyOld(one) ? '' : controlText(one)}</span>
  </button>`;
}

/** Why nothing is known about a gripper of the fleet; null if it sends its values. */
function whySilent(one) {
  if (one.gone) return t('link.gone');
  return one.link === 'connected' ? null : t(`stale.link.${one.link}`);
}

function FleetState({ one }) {
  if (one.fast_stop) return t('state.FAST_STOP');
  const isUnknown = one.fast_stop == null || one.state == null;
  const why = whySilent(one) ?? (isUnknown ? t('all.no_value') : null);
  if (why === null) return t(`state.${one.state}`);
  return html`<${Unknown} word=${t('state.unknown')} why=${why} />`;
}

function FleetAge({ one }) {
  const { age_ms: age } = one;
  if (age === null || age === undefined) return html`<${Unknown} why=${whySilent(one) ?? t('all.no_value')} />`;
  return age < 1000 ? `${plain(age)} ms` : span(age);
}

function Fleet() {
  useEffect(() => {
    askFleet();
    const timer = setInterval(askFleet, ASKED_EVERY_MS);
    return () => clearInterval(timer);
  }, []);
  const list = fleet.value;
  const old = whyOld(null);
  if (old) return html`<p role="status">${old.text}</p>`;
  if (!hasOthers.value) return html`<p class="muted small">${list ? t('all.no_fleet') : ''}</p>`;
  const actions = html`<button type="button" id="stop-fleet" class="at-once" ...${onPress(stopFleet)}>${t(
    'stop.fleet',
    {
      count: list.length,
    },
  )}</button>`;
  return html`<${Panel} title=${t('all.fleet')} id="fleet-title" actions=${actions}><div class="table-place" tabindex="0" role="group"
      aria-label=${t('all.fleet')}><table>
    <thead><tr>${['all.gateway', 'all.gripper', 'bar.link', 'bar.state', 'bar.control', 'all.age'].map(
      (key) => html`<th scope="col" key=${key}>${t(key)}</th>`,
    )}</tr></thead>
    <tbody>${list.map(
      (one) => html`<tr key=${`${one.gateway}/${one.gripper}`}
        class=${one.fast_stop ? 'stop-row' : one.link === 'connected' && !one.gone ? '' : 'bad'}>
      <td>${
        one.dashboard && !one.gone
          ? html`<a href=${one.dashboard} target="_blank" rel="noopener">${one.gateway}</a>`
          : one.gateway
      }</td><td>${one.gripper}</td><td>${t(`link.${one.gone ? 'gone' : one.link}`)}</td>
        <td><${FleetState} one=${one} /></td>
          <td>${one.lease_holder ?? '–'}</td>
            <td><${FleetAge} one=${one} /></td>
              </tr>`,
    )}</tbody>
  </table></div></${Panel}>`;
}

export function All() {
  return html`<div class="column"><${Panel} title=${t('all.title')} id="all-title"><div
      class="tiles">${grippers.value.map((one) => html`<${Tile} key=${one.name} one=${one} />`)}</div></${Panel}>
        <${Fleet} /></div>`;
}
