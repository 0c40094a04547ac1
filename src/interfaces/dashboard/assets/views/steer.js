// A slider that steers the fingers while it is held.

import { html, useEffect, useMemo, useSignal } from '../lib.js';
import { mistake } from '../core/limits.js';
import { fixed, t } from '../model/i18n.js';
import { Steering } from '../model/steering.js';
import { onHold, useLettingGo } from '../ui/hold.js';

/** Keys that change the value of a slider. */
const KEYS = /^(Arrow|Page|Home$|End$)/;

/** Reasons that a held slider is itself. */
const OWN = ['why.steered', 'why.running'];

/** `speed` in mm/s and `force` in N are the limits of the session; without a valid force, it sets none. */
export function Slider({ gripper, speed, force, limits, reason }) {
  const steering = useMemo(() => new Steering(), [gripper]);
  /** Target width while the slider is held, or null. */
  const held = useSignal(null);
  const end = () => {
    steering.end();
    held.value = null;
  };
  useLettingGo(end, gripper);
  const { min, max } = limits.width.value;
  const isKnown = gripper.width.value !== null && Number.isFinite(max);
  const isOff = !isKnown || (reason !== null && !(held.value !== null && OWN.includes(reason)));
  // A disabled slider sends no event when it is released.
  useEffect(() => {
    if (isOff) end();
  }, [isOff]);
  const width = held.value ?? gripper.reading.value?.width_mm;
  const begin = ({ currentTarget: slider }) => {
    if (isOff || held.peek() !== null) return;
    held.value = slider.valueAsNumber;
    const force_n = mistake(force, limits.force.peek()) ? undefined : force;
    steering.begin(gripper, slider.valueAsNumber, { max_speed_mm_s: speed, force_n });
  };
  return html`<div class="steer"><label for="steer">${t('steer.title')}</label>
    <input id="steer" class="slider" type="range" min=${min} max=${isKnown ? max : min} step="0.5" disabled=${isOff}
      value=${width ?? min} aria-valuetext=${`${fixed(width, 1)} mm`}
      ...${onHold(begin, end)}
      onKeyDown=${(event) => KEYS.test(event.key) && begin(event)} onKeyUp=${end}
      onInput=${({ currentTarget: slider }) => {
        if (held.peek() === null) return;
        held.value = slider.valueAsNumber;
        steering.aim(slider.valueAsNumber);
      }} />
    <span>${fixed(width, 1)} mm</span></div>`;
}
