// Jogging while a button is held, and in small steps.

import { html, useEffect, useMemo } from '../lib.js';
import { mistake, number } from '../core/limits.js';
import { plain, t } from '../model/i18n.js';
import { move } from '../model/commands.js';
import { Jog } from '../model/jog.js';
import { onHold, useLettingGo } from '../ui/hold.js';
import { Slider } from './steer.js';

const STEPS_MM = [0.1, 1, 5];
/** Speed of jogging, unless the field's is lower. */
const JOG_MM_S = 25;

function HoldButton({ id, label, jog, gripper, direction, speed, limits, disabled }) {
  const begin = () => disabled || jog.begin(gripper, direction, speed, limits);
  const end = () => jog.end();
  // A disabled button sends no event when it is released.
  useEffect(() => {
    if (disabled) end();
  }, [disabled]);
  const isKey = ({ key }) => key === ' ' || key === 'Enter';
  return html`<button type="button" id=${id} class="hold" disabled=${disabled}
    ...${onHold(begin, end)}
    onKeyDown=${(event) => {
      if (isKey(event)) {
        event.preventDefault();
        if (!event.repeat) begin();
      }
    }}
    onKeyUp=${(event) => {
      if (isKey(event)) {
        event.preventDefault();
        end();
      }
    }}>${label}</button>`;
}

export function JogPanel({ gripper, speed, force, limits, reason }) {
  const jog = useMemo(() => new Jog(), [gripper]);
  useLettingGo(() => jog.end(), gripper);
  const given = number(speed.value);
  const { min, max } = limits.speed.value;
  const pace = Math.min(max, Math.max(min, mistake(given, limits.speed.value) ? JOG_MM_S : Math.min(given, JOG_MM_S)));
  const widths = limits.width.value;
  // The running motion can be that of the held button, which must not be disabled by it.
  const isOff = reason !== null && reason !== 'why.running';
  const canStep = (by) =>
    reason === null &&
    gripper.width.value !== null &&
    !mistake(Math.min(widths.max, Math.max(widths.min, gripper.width.value)) + by, widths);
  const step = (by) => move(gripper, 'move', { width_mm: by, relative: true, speed_mm_s: pace });
  return html`<div class="jog" role="group" aria-label=${t('jog.title')}>
    <div class="holds">
      <${HoldButton} id="jog-close" label=${html`<span aria-hidden="true">\u25b6\u25c0</span> ${t('jog.close')}`}
          jog=${jog} gripper=${gripper} direction=${-1} speed=${pace} limits=${widths} disabled=${isOff} />
      <${HoldButton} id="jog-open" label=${html`<span aria-hidden="true">\u25c0\u25b6</span> ${t('jog.open')}`}
          jog=${jog} gripper=${gripper} direction=${1} speed=${pace} limits=${widths} disabled=${isOff} />
    </div>
    <div class="steps">
      ${[...STEPS_MM].reverse().map(
        (mm) => html`<button type="button" key=${-mm} disabled=${!canStep(-mm)}
          onClick=${() => step(-mm)}>−${plain(mm)}</button>`,
      )}
      ${STEPS_MM.map(
        (mm) => html`<button type="button" key=${mm} disabled=${!canStep(mm)}
          onClick=${() => step(mm)}>+${plain(mm)}</button>`,
      )}
    </div>
    <${Slider} gripper=${gripper} speed=${pace} force=${number(force.value)} limits=${limits} reason=${reason} />
    <p class="hint">${t('jog.hint', { speed: plain(pace) })}</p>
  </div>`;
}
