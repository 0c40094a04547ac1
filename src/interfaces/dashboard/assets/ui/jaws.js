// The jaws, drawn to scale, with target, soft limits and part.

import { html, useComputed } from '../lib.js';
import { fixed, plain, t } from '../model/i18n.js';
import { Covered, Figure, Panel, Shape, whyOld } from './parts.js';
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
          x=${MIDDLE + (side * mm * scale) / 2} y="232">${mm}</text>`,
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

function Target({ one, scale }) {
  const target = one.target.value;
  if (!target || target.width_mm === null || !one.isReferenced.value) return null;
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

function words(one) {
  const parts = [t(`state.${one.condition.value ?? 'unknown'}`)];
  if (one.direction.value < 0) parts.push(t('jaws.closing'));
  if (one.direction.value > 0) parts.push(t('jaws.opening'));
  const target = one.target.value?.width_mm;
  if (target !== null && target !== undefined) parts.push(t('jaws.target', { width: plain(target) }));
  return parts.join(' · ');
}

function Drawing({ one }) {
  const stroke = one.info.value?.stroke_mm ?? 110;
  const scale = SPAN / stroke;
  const half = useComputed(() => ((one.width.value ?? stroke / 2) * scale) / 2);
  const left = useComputed(() => `translate(${(MIDDLE - half.value).toFixed(1)} 0)`);
  const right = useComputed(() => `translate(${(MIDDLE + half.value).toFixed(1)} 0)`);
  const from = useComputed(() => (MIDDLE - half.value).toFixed(1));
  const to = useComputed(() => (MIDDLE + half.value).toFixed(1));
  const between = useComputed(() => (2 * half.value).toFixed(1));
  // Signals in attributes follow the width without rendering the whole drawing again.
  const isKnown = useComputed(() => one.width.value !== null).value;
  const why = useComputed(() => unknownText(one.state.value, 'width_mm'));
  // Between the jaws, there is no room for the reason.
  const note = useComputed(() => t(one.isReferenced.value === false ? 'unknown.not_referenced' : 'unknown.width'));
  const label = useComputed(() => why.value ?? t('jaws.label', { width: fixed(one.reading.value?.width_mm, 1) }));
  const widthText = useComputed(() => t('jaws.width', { width: fixed(one.width.value, 1) }));
  const isHolding = one.gripperState.value === 'HOLDING';
  const isLost = one.gripperState.value === 'PART_LOST';
  return html`<svg class=${`jaws ${isKnown ? '' : 'unknown'}`} viewBox="0 0 680 242" role="img"
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
    ${isHolding && isKnown && one.force.value !== null && html`<text class="part-text" x=${MIDDLE} y="139">${fixed(one.force.value, 1)} N</text>`}
    <${Jaw} side=${-1} place=${left} direction=${one.direction.value} />
    <${Jaw} side=${1} place=${right} direction=${one.direction.value} />
    ${
      isKnown &&
      html`<g class="dimension"><line x1=${from} x2=${to} y1="174" y2="174" /><line x1=${from} x2=${from}
        y1="168" y2="180" /><line x1=${to} x2=${to} y1="168" y2="180" /><text x=${MIDDLE}
        y="196">${widthText}</text></g>`
    }
    <${Forbidden} soft=${one.softLimits.value} stroke=${stroke} scale=${scale} />
    <g class="ruler"><line x1=${MIDDLE - SPAN / 2} x2=${MIDDLE + SPAN / 2} y1="208" y2="208" />${ticks(stroke, scale)}
      </g>
    <${Target} one=${one} scale=${scale} />
    ${!isKnown && html`<text class="jaws-note" x=${MIDDLE} y="140">${note}</text>`}
  </svg>`;
}

function Figures({ one }) {
  const read = one.reading.value;
  const info = one.info.value;
  const soft = one.softLimits.value;
  const hasSoft = soft?.minus_mm != null;
  const widths = hasSoft
    ? t('figure.soft', { min: plain(soft.minus_mm), max: plain(soft.plus_mm) })
    : t('figure.stroke', { max: plain(info?.stroke_mm) });
  return html`<div class="figures">
    <${Figure} label=${t('width')} value=${read?.width_mm} decimals=${2} unit="mm" note=${widths} timed="width"
        why=${unknownText(read, 'width_mm')} class="figure-main" />
    <${Figure} label=${t('speed')} value=${read?.speed_mm_s} decimals=${1} unit="mm/s" why=${unknownText(read, 'speed_mm_s')}
        note=${t('figure.max', {
          max: plain(info?.max_speed_mm_s),
          unit: 'mm/s',
        })} />
    <${Figure} label=${t('force')} value=${read?.force_n} decimals=${1} unit="N" why=${unknownText(read, 'force_n')}
        note=${t('figure.max', {
          max: plain(one.hasOverdrive.value ? info?.overdrive_force_n : info?.nominal_force_n),
          unit: 'N',
        })} />
  </div>`;
}

/** Names the values that the gripper does not send. */
function Missing({ one }) {
  const text = missingText(one);
  return text && html`<p class="unknown-values tone-high"><${Shape} name="high" /> <span>${text}</span></p>`;
}

export function Jaws({ one }) {
  return html`<${Panel} title=${one.name} id="jaws-title" class="jaws-panel" actions=${
    !whyOld(one) &&
    html`<span class="jaws-words" data-state=${one.condition.value}>${words(one)}</span><${Result} one=${one} />`
  }>
    <${Covered} one=${one}><${Missing} one=${one} /><${Drawing} one=${one} /><${Figures} one=${one} /></${Covered}>
  </${Panel}>`;
}
