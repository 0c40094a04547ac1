// The state machine, and the 32 system state flags in plain words.

import { html } from '../lib.js';
import { FLAGS, isSet } from '../core/flags.js';
import { t } from '../model/i18n.js';
import { Covered, Panel, Shape, whyOld } from '../ui/parts.js';
import { unknownText } from '../ui/unknown.js';

const BOXES = {
  IDLE: [10, 70],
  POSITIONING: [10, 150],
  RELEASING: [180, 150],
  GRASPING: [180, 70],
  HOLDING: [350, 70],
  NO_PART: [350, 10],
  PART_LOST: [350, 150],
  ERROR: [10, 10],
};
const W = 130;
const H = 40;

/** Transitions, as SVG paths. */
const WAYS = [
  'M75 110v40',
  'M140 90h40',
  'M310 90h40',
  'M310 80q24 -46 40 -50',
  'M415 110v40',
  'M350 104Q290 150 290 150',
  'M180 162Q150 130 110 110',
  'M350 175h-40',
];

export function StateMachine({ gripper }) {
  const current = gripper.latchId.value ? 'ERROR' : gripper.gripperState.value;
  return html`<svg class="machine" viewBox="0 0 490 200" role="img" aria-label=${t('machine.label', {
    state: t(`state.${current ?? 'unknown'}`),
  })}>
    <defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7"
        orient="auto-start-reverse"><path d="M0 0 8 4 0 8z" /></marker></defs>
    <g class="ways">${WAYS.map((d) => html`<path key=${d} d=${d} marker-end="url(#tip)" />`)}</g>
    ${Object.entries(BOXES).map(
      ([state, [x, y]]) => html`<g key=${state}
        class=${`box ${state === current ? 'current' : ''} ${state === current && state === 'ERROR' ? 'tone-critical' : ''}`}>
      <rect x=${x} y=${y} width=${W} height=${H} rx="4" /><text x=${x + W / 2} y=${y + 18}>${t(`state.${state}`)}
        </text><text class="name" x=${x + W / 2} y=${y + 32}>${state}</text></g>`,
    )}
  </svg>`;
}

function Flag({ flag, raw }) {
  const { bit, name, weight } = flag;
  const isOn = isSet(raw, bit);
  const text = raw === null ? 'flag.unknown' : isOn ? 'flag.set' : 'flag.clear';
  const shape = isOn ? { fault: 'critical', warning: 'high', normal: 'on' }[weight] : 'off';
  return html`<li class=${`flag ${isOn ? 'set' : ''} ${isOn && weight !== 'normal' ? `tone-${weight === 'fault' ? 'critical' : 'high'}` : ''}`}
      title=${name ?? ''}>
    ${raw === null ? html`<span class="shape" aria-hidden="true">–</span>` : html`<${Shape} name=${shape} />`}<span class="flag-bit">${bit}</span><span
        class="flag-text">${name ? t(`flag.${name}`) : t('flag.reserved')}</span><span
            class="visually-hidden">${t(text)}</span></li>`;
}

export function Flags({ gripper }) {
  const raw = gripper.flags.value;
  return html`<${Panel} title=${t('flags.title')} id="flags-title" class="flags-panel"
      actions=${
        raw !== null &&
        !whyOld(gripper) &&
        html`<code class="muted small">0x${raw.toString(16).padStart(8, '0')}
        </code>`
      }>
    <${Covered} gripper=${gripper}>
      ${['state', 'flags'].map((name) => {
        const why = unknownText(gripper.state.value, name);
        return why && html`<p class="small" key=${name}>${why}</p>`;
      })}
      <${StateMachine} gripper=${gripper} />
      <ul class="flags">${FLAGS.filter(({ name, bit }) => name || isSet(raw, bit)).map(
        (flag) => html`<${Flag}
          key=${flag.bit} flag=${flag} raw=${raw} />`,
      )}</ul>
      <p class="hint">${t('flags.reserved')}</p>
    </${Covered}>
  </${Panel}>`;
}
