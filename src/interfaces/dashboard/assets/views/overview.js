// All grippers at a glance, and the fleet if there is one.

import { html, useEffect } from '../lib.js';
import { numbered } from '../core/newest.js';
import { fixed, plain, span, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { fleet, grippers, hasOthers, isLive, selected } from '../model/store.js';
import { onPress, Panel, Shape, whyOld } from '../ui/parts.js';
import { go } from '../ui/route.js';
import { stopFleet } from '../ui/stop.js';

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
  const gap = ((one.width.value ?? 0) / stroke) * 200;
  return html`<svg class="gauge" viewBox="0 0 200 14" preserveAspectRatio="none" aria-hidden="true"><rect
      class="track" width="200" height="14" rx="2" /><rect class="gap" x=${(100 - gap / 2).toFixed(1)}
          width=${gap.toFixed(1)} height="14" /></svg>`;
}

function controlText(one) {
  if (one.reservedFor.value) return t('bar.reserved', { name: one.reservedFor.value });
  return one.holder.value ? t('all.control', { holder: one.holder.value }) : t('all.no_control');
}

function Tile({ one }) {
  const old = whyOld(one);
  const isLatched = one.latchId.value !== null;
  const state = isLatched ? 'FAST_STOP' : (one.gripperState.value ?? 'unknown');
  const tone = old || state === 'PART_LOST' ? 'tone-high' : isLatched || state === 'ERROR' ? 'tone-critical' : '';
  const shape = old ? 'high' : isLatched ? 'critical' : one.isMoving.value ? 'moving' : 'on';
  return html`<button type="button" class="tile" data-gripper=${one.name}
      onClick=${() => {
        selected.value = one.name;
        go('operate');
      }}>
    <span class="tile-head"><span>${one.name}</span><span class=${`tile-state ${tone}`}><${Shape}
        name=${shape} />${old ? old.text : t(`state.${state}`)}</span></span>
    ${
      old
        ? html`<span class="muted small">${old.detail ?? ''}</span>`
        : html`<${Gauge} one=${one} />
      <span class="tile-figures"><span>${fixed(one.width.value, 1)}<span class="unit">mm</span></span>
        <span>${fixed(one.speed.value, 0)}<span class="unit">mm/s</span></span><span>${fixed(one.force.value, 1)}<span
            class="unit">N</span></span></span>`
    }
    <span class="muted small">${whyOld(one) ? '' : controlText(one)}</span>
  </button>`;
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
        <td>${one.fast_stop ? t('state.FAST_STOP') : t(`state.${one.state ?? 'unknown'}`)}</td>
          <td>${one.lease_holder ?? '–'}</td>
            <td>${one.age_ms == null ? '–' : one.age_ms < 1000 ? `${plain(one.age_ms)} ms` : span(one.age_ms)}</td>
              </tr>`,
    )}</tbody>
  </table></div></${Panel}>`;
}

export function All() {
  return html`<div class="column"><${Panel} title=${t('all.title')} id="all-title"><div
      class="tiles">${grippers.value.map((one) => html`<${Tile} key=${one.name} one=${one} />`)}</div></${Panel}>
        <${Fleet} /></div>`;
}
