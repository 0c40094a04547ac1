// The jaws, drawn to scale, with target, soft limits and part.

import { html, useComputed } from '../lib.js';
import { fixed, plain, t } from '../model/i18n.js';
import { Covered, Figure, Name, Panel, Shape, whyOld } from './parts.js';
import { Result } from './result.js';
import { missingText, unknownText } from './unknown.js';

const MIDDLE = 340;
const SPAN = 540;
const TICK_MM = 10;

function ticks(stroke, scale) {
  const widths = Array.from({ length: Math.floor(stroke / TICK_MM) + 1 }, (_, index) => index * TICK_MM);
  return widths.map((mm) => {
    const isLong = mm % (TICK_MM * 2) === 0;
    return html`<g key=${mm}>
      ${[-1, 1].map(
        (side) => html`<line x1=${MIDDLE + (side * mm * scale) / 2} x2=${MIDDLE + (side * mm * scale) / 2}
          y1="208" y2=${isLong ? 218 : 213} />`,
      )}
      ${
        isLong &&
        [-1, 1]
          .filter((side) => mm > 0 || side > 0)
          .map(
            (side) => html`<text
          x=${MIDDLE + (side * mm * scale) / 2} y="236">${mm}</text>`,
          )
      }
    </g>`;
  });
}

/** Widths outside the soft limits, on the ruler. */
function Forbidden({ soft, stroke, scale }) {
  if (soft?.minus_mm == null) return null;
  const x = (mm) => (mm * scale) / 2;
  const outer = x(stroke) - x(soft.plus_mm);
  return html`<g class="forbidden">
    ${
      soft.minus_mm > 0 &&
      html`<rect x=${MIDDLE - x(soft.minus_mm)} y="199" width=${2 * x(soft.minus_mm)}
        height="9" />`
    }
    ${
      outer > 0 &&
      html`<rect x=${MIDDLE + x(soft.plus_mm)} y="199" width=${outer} height="9" /><rect
        x=${MIDDLE - x(stroke)} y="199" width=${outer} height="9" />`
    }
  </g>`;
}

function Target({ gripper, scale }) {
  const target = gripper.target.value;
  if (!target || target.width_mm === null || !gripper.isReferenced.value) return null;
  const half = (target.width_mm * scale) / 2;
  return html`<g class="target">
    ${[-1, 1].map(
      (side) => html`<line x1=${MIDDLE + side * half} x2=${MIDDLE + side * half} y1="70" y2="204" /><path
        d="M-6 66h12l-6 9z" transform=${`translate(${MIDDLE + side * half} 0)`} />`,
    )}
  </g>`;
}

function Jaw({ side, place, direction }) {
  const mirror = side < 0 ? 'scale(-1 1)' : '';
  return html`<g transform=${place}><g transform=${mirror}>
    <path class="jaw" d="M0 84v80h16v-60l34-16V64h18V44H6v40z" />
    ${
      direction !== 0 &&
      html`<path class="arrow"
        d=${direction > 0 ? 'M24 47h12v-5l12 11-12 11v-5H24z' : 'M48 47H36v-5L24 53l12 11v-5h12z'} />`
    }
  </g></g>`;
}

function words(gripper) {
  const parts = [t(`state.${gripper.condition.value ?? 'unknown'}`)];
  if (gripper.direction.value < 0) parts.push(t('jaws.closing'));
  if (gripper.direction.value > 0) parts.push(t('jaws.opening'));
  const target = gripper.target.value?.width_mm;
  if (target !== null && target !== undefined) parts.push(t('jaws.target', { width: plain(target) }));
  return parts.join(' · ');
}

function Drawing({ gripper }) {
  const stroke = gripper.info.value?.stroke_mm ?? 110;
  const scale = SPAN / stroke;
  const half = useComputed(() => ((gripper.width.value ?? stroke / 2) * scale) / 2);
  const left = useComputed(() => `translate(${(MIDDLE - half.value).toFixed(1)} 0)`);
  const right = useComputed(() => `translate(${(MIDDLE + half.value).toFixed(1)} 0)`);
  const from = useComputed(() => (MIDDLE - half.value).toFixed(1));
  const to = useComputed(() => (MIDDLE + half.value).toFixed(1));
  const between = useComputed(() => (2 * half.value).toFixed(1));
  // Signals in attributes follow the width without rendering the whole drawing again.
  const isKnown = useComputed(() => gripper.width.value !== null).value;
  const why = useComputed(() => unknownText(gripper.state.value, 'width_mm'));
  // Between the jaws, there is no room for the reason.
  const note = useComputed(() => t(gripper.isReferenced.value === false ? 'jaws.not_referenced' : 'unknown.width'));
  const label = useComputed(() => why.value ?? t('jaws.label', { width: fixed(gripper.reading.value?.width_mm, 1) }));
  const isHolding = gripper.gripperState.value === 'HOLDING';
  const isLost = gripper.gripperState.value === 'PART_LOST';
  return html`<svg class=${`jaws ${isKnown ? '' : 'unknown'}`} viewBox="0 0 680 246" role="img"
      aria-label=${label}>
    <defs><pattern id="hatch" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><rect
        width="2.5" height="6" /></pattern></defs>
    <rect class="body" x="0" y="14" width="680" height="30" rx="6" />
    <path class="rail" d="M16 36h648" />
    ${
      (isHolding || isLost) &&
      isKnown &&
      html`<rect class=${isLost ? 'part lost' : 'part'} x=${from} y="108"
        width=${between} height="52" rx="2" />`
    }
    <${Jaw} side=${-1} place=${left} direction=${gripper.direction.value} />
    <${Jaw} side=${1} place=${right} direction=${gripper.direction.value} />
    ${
      isKnown &&
      html`<g class="dimension"><line x1=${from} x2=${to} y1="174" y2="174" /><line x1=${from} x2=${from}
        y1="168" y2="180" /><line x1=${to} x2=${to} y1="168" y2="180" /></g>`
    }
    <${Forbidden} soft=${gripper.softLimits.value} stroke=${stroke} scale=${scale} />
    <g class="ruler"><line x1=${MIDDLE - SPAN / 2} x2=${MIDDLE + SPAN / 2} y1="208" y2="208" />${ticks(stroke, scale)}
      </g>
    <${Target} gripper=${gripper} scale=${scale} />
    ${!isKnown && html`<text class="jaws-note" x=${MIDDLE} y="140">${note}</text>`}
  </svg>`;
}

function Figures({ gripper }) {
  const read = gripper.reading.value;
  const info = gripper.info.value;
  const soft = gripper.softLimits.value;
  const hasSoft = soft?.minus_mm != null;
  const widths = hasSoft
    ? t('figure.soft', { min: plain(soft.minus_mm), max: plain(soft.plus_mm) })
    : t('figure.stroke', { max: plain(info?.stroke_mm) });
  return html`<div class="figures">
    <${Figure} label=${t('width')} value=${read?.width_mm} decimals=${2} unit="mm" note=${widths} timed="width"
        why=${unknownText(read, 'width_mm')} class="figure-main" />
    <${Figure} label=${t('force')} value=${read?.force_n} decimals=${1} unit="N" why=${unknownText(read, 'force_n')}
        note=${t('figure.max', {
          max: plain(gripper.hasOverdrive.value ? info?.overdrive_force_n : info?.nominal_force_n),
          unit: 'N',
        })} class="figure-force" />
    <${Figure} label=${t('speed')} value=${read?.speed_mm_s} decimals=${1} unit="mm/s" why=${unknownText(read, 'speed_mm_s')}
        note=${t('figure.max', {
          max: plain(info?.max_speed_mm_s),
          unit: 'mm/s',
        })} class="figure-speed" />
  </div>`;
}

/** Names the values that the gripper does not send. */
function Missing({ gripper }) {
  const text = missingText(gripper);
  return text && html`<p class="unknown-values tone-high"><${Shape} name="high" /> <span>${text}</span></p>`;
}

/** The gripper's state or the result of its grip; nothing while old values are covered. */
function Now({ gripper }) {
  const old = whyOld(gripper) !== null;
  return html`<div class="now" inert=${old}>${
    !old &&
    html`<div class="jaws-words" data-state=${gripper.condition.value}><${Result} gripper=${gripper}>${words(gripper)}</${Result}></div>`
  }</div>`;
}

export function Jaws({ gripper }) {
  return html`<${Panel} title=${html`<${Name} text=${gripper.name} />`} id="jaws-title" class="jaws-panel">
    <${Now} gripper=${gripper} />
    <${Covered} gripper=${gripper}><${Missing} gripper=${gripper} /><${Figures} gripper=${gripper} /><${Drawing} gripper=${gripper} /></${Covered}>
  </${Panel}>`;
}
