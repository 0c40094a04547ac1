// All grippers at a glance, and the fleet if there is one.

import { html, useEffect, useRef } from '../lib.js';
import { isOpen, sorted } from '../core/alarms.js';
import { numbered } from '../core/newest.js';
import { fixed, plain, span, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { alarms } from '../model/alarms.js';
import { stepOf } from '../model/steps.js';
import { fleet, grippers, hasOthers, isLive, now, selected } from '../model/state.js';
import { kindText } from '../ui/alarm.js';
import { Name, onPress, Panel, Shape, shapeOf, whyOld } from '../ui/parts.js';
import { isAcknowledged } from '../ui/result.js';
import { go } from '../ui/route.js';
import { stopFleet, stopOne } from '../ui/stop.js';
import { missingText, Unknown, unknownText } from '../ui/unknown.js';

const ASKED_EVERY_MS = 2000;

const FAILED_STATES = ['PART_LOST', 'NO_PART'];

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

function Gauge({ gripper }) {
  const stroke = gripper.info.value?.stroke_mm ?? 110;
  const width = gripper.width.value;
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

function controlText(gripper) {
  if (gripper.reservedFor.value) return t('bar.reserved', { name: gripper.reservedFor.value });
  return gripper.holder.value ? t('all.control', { holder: gripper.holder.value }) : t('all.no_control');
}

/** How much a gripper needs a person: 0 the most. */
function needOf(gripper) {
  if (gripper.latchId.value !== null) return 0;
  const state = gripper.condition.value;
  if (state === 'PART_LOST' || (state === 'ERROR' && !isAcknowledged(gripper))) return 1;
  if (whyOld(gripper) !== null || state === null) return 2;
  if (openAlarms(gripper).length > 0) return 3;
  if (state === 'NO_PART' || gripper.reservedFor.value !== null) return 4;
  return gripper.isReferenced.value === false ? 5 : 6;
}

const openAlarms = (gripper) => alarms.value.filter((alarm) => alarm.gripper === gripper.name && isOpen(alarm));

/** Words for the next step of a tile; empty if nobody has to do anything. */
function stepText(gripper) {
  const step = stepOf(gripper);
  return ['acknowledge', 'home', 'release'].includes(step) ? t(`next.${step}`) : '';
}

function Tile({ gripper }) {
  const old = whyOld(gripper);
  const isLatched = gripper.latchId.value !== null;
  const state = isAcknowledged(gripper) && !isLatched ? 'acknowledged' : (gripper.condition.value ?? 'unknown');
  const tone =
    old || FAILED_STATES.includes(state) ? 'tone-high' : isLatched || state === 'ERROR' ? 'tone-critical' : '';
  const why = missingText(gripper) ?? unknownText(gripper.state.value, 'width_mm');
  const open = openAlarms(gripper);
  const part = gripper.part.value;
  return html`<li class="tile" data-need=${needOf(gripper)}><button type="button" class="tile-open" data-gripper=${gripper.name} onClick=${() => {
    selected.value = gripper.name;
    go('operate');
  }}>
    <span class="tile-head"><${Name} text=${gripper.name} /><span class=${`tile-state ${tone}`}><${Shape}
        name=${shapeOf(gripper)} />${old ? old.text : t(`state.${state}`)}</span></span>
    ${
      old
        ? html`<span class="muted small">${old.detail ?? ''}</span>`
        : html`<${Gauge} gripper=${gripper} />
      <${Figures} state=${gripper.state.value} />${why && html`<span class="small">${why}</span>`}`
    }
    <span class="muted small tile-facts">${old ? '' : controlText(gripper)}${part && html` · <${Name} text=${part} />`}</span>
    ${open.length > 0 && html`<span class="small tile-alarms"><${Shape} name=${sorted(open)[0].priority} /> ${open.map(kindText).join(', ')}</span>`}
    ${stepText(gripper) && html`<span class="small tile-step"><${Shape} name="next" /> ${stepText(gripper)}</span>`}
  </button>
  <button type="button" class="at-once tile-stop" aria-label=${`FAST STOP ${gripper.name}`} ...${onPress(() => stopOne(gripper))}>FAST STOP</button></li>`;
}

/** Time without a touch after which the order may change. */
const STILL_MS = 1500;

/** Grippers in the order of their need, which does not change under a finger. */
function useOrder() {
  const touchedAt = useRef(-Infinity);
  const order = useRef([]);
  // The clock brings a change that had to wait.
  const wanted = now.value && [...grippers.value].sort((a, b) => needOf(a) - needOf(b));
  const isSame = wanted.length === order.current.length && wanted.every((gripper) => order.current.includes(gripper));
  if (!isSame || performance.now() - touchedAt.current > STILL_MS) order.current = wanted;
  const touch = () => {
    touchedAt.current = performance.now();
  };
  return { list: order.current, touch };
}

/** Why nothing is known about a gripper of the fleet; null if it sends its values. */
function whySilent(gripper) {
  if (gripper.gone) return t('link.gone');
  return gripper.link === 'connected' ? null : t(`stale.link.${gripper.link}`);
}

function FleetState({ gripper }) {
  if (gripper.fast_stop) return t('state.FAST_STOP');
  const isUnknown = gripper.fast_stop == null || gripper.state == null;
  const why = whySilent(gripper) ?? (isUnknown ? t('all.no_value') : null);
  if (why === null) return t(`state.${gripper.state}`);
  return html`<${Unknown} word=${t('state.unknown')} why=${why} />`;
}

function FleetAge({ gripper }) {
  const { age_ms: age } = gripper;
  if (age === null || age === undefined) return html`<${Unknown} why=${whySilent(gripper) ?? t('all.no_value')} />`;
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
      (gripper) => html`<tr key=${`${gripper.gateway}/${gripper.gripper}`}
        class=${gripper.fast_stop ? 'stop-row' : gripper.link === 'connected' && !gripper.gone ? '' : 'bad'}>
      <td>${
        gripper.dashboard && !gripper.gone
          ? html`<a href=${gripper.dashboard} target="_blank" rel="noopener">${gripper.gateway}</a>`
          : gripper.gateway
      }</td><td>${gripper.gripper}</td><td>${t(`link.${gripper.gone ? 'gone' : gripper.link}`)}</td>
        <td><${FleetState} gripper=${gripper} /></td>
          <td>${gripper.lease_holder ?? '–'}</td>
            <td><${FleetAge} gripper=${gripper} /></td>
              </tr>`,
    )}</tbody>
  </table></div></${Panel}>`;
}

export function All() {
  const { list, touch } = useOrder();
  return html`<div class="column"><${Panel} title=${t('all.title')} id="all-title"><ul class="tiles" onPointerMove=${touch}
      onPointerDown=${touch}>${list.map((gripper) => html`<${Tile} key=${gripper.name} gripper=${gripper} />`)}</ul></${Panel}>
        <${Fleet} /></div>`;
}
