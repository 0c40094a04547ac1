// Result of the newest grip or motion, in large type beside the jaws.

import { html } from '../lib.js';
import { FLAGS, isSet } from '../core/flags.js';
import { isGrip } from '../core/kinds.js';
import { fixed, plain, t } from '../model/i18n.js';
import { Shape } from './parts.js';

/** Gripper states that are results of a grip. */
const HELD = 'HOLDING';
const FAILED = ['NO_PART', 'PART_LOST'];

/** Outcome of a grip that holds a part outside the limits of its recipe, and its `outcome_code`. */
const WRONG_PART = 'WRONG_PART';
const WRONG_PART_CODE = 11;

const FAULTS = FLAGS.filter(({ weight }) => weight === 'fault');

/** `fault_code` of an error that nobody has acknowledged. */
const DEVICE_ERROR = 30;

/** `fault_code` of an unknown value, which hides that of an error. */
const VALUE_UNKNOWN = 4;

const GOOD = ['SUCCESS', 'PART_HELD'];

/** Difference from the expected width up to which a held part gets no note. */
const TOLERANCE_MM = 2;

/** Whether a command has ended without success. */
export const hasFailed = ({ phase, outcome }) => phase !== 'running' && Boolean(outcome) && !GOOD.includes(outcome);

function early(command, width) {
  const aim = isGrip(command?.kind) ? command.aim_mm : null;
  return aim == null || width == null || Math.abs(width - aim) <= TOLERANCE_MM
    ? null
    : t('result.early', { width: fixed(width, 1), aim: plain(aim) });
}

function resultOf(one) {
  const command = one.command.value;
  const state = one.gripperState.value;
  if (one.latchId.value || command?.phase === 'running') return null;
  if (state === HELD) {
    // `reading` is read only in this state, so that moving fingers do not render the result again.
    const { width_mm: width, force_n: force } = one.reading.value ?? {};
    const known = [
      [width, 'mm'],
      [force, 'N'],
    ].filter(([value]) => value != null);
    const figures = known.map(([value, unit]) => `${fixed(value, 1)} ${unit}`).join(' · ');
    // The newest command can be a Stop, which does not change the grip's result.
    if (one.outcomeCode.value === WRONG_PART_CODE) {
      const contact = command?.outcome === WRONG_PART ? command.contact_width_mm : null;
      const note = contact === null ? null : t('result.contact', { width: fixed(contact, 2) });
      return { state: WRONG_PART, isWrong: true, text: t('result.wrong_part'), figures, note };
    }
    return { state, text: t('result.held'), figures, note: early(command, width) };
  }
  // Firmware 4 reports ERROR from a FAST STOP until the next motion, even after the acknowledgement.
  const flags = one.flags.value;
  if (state === 'ERROR' && flags !== null && !FAULTS.some(({ bit }) => isSet(flags, bit))) {
    if (one.faultCode.value === VALUE_UNKNOWN) return { state, isWrong: true, text: t('result.error'), figures: '' };
    const isOpen = one.faultCode.value === DEVICE_ERROR;
    const note = t(isOpen ? 'result.open' : 'result.ready');
    return { state, isWrong: isOpen, text: t('result.error'), figures: '', note };
  }
  if (FAILED.includes(state)) return { state, isWrong: true, text: t(`state.${state}`), figures: '' };
  if (!command || !hasFailed(command)) return null;
  const at = command.width_mm == null ? null : t('result.at', { width: fixed(command.width_mm, 1) });
  const text = `${t(`command.${command.kind}`)}: ${t(`outcome.${command.outcome}`)}`;
  return { state: command.outcome, isWrong: true, text, figures: '', note: at };
}

export function Result({ one }) {
  const result = resultOf(one);
  if (!result) return null;
  const { state, isWrong, text, figures, note } = result;
  return html`<p class=${`result ${isWrong ? 'tone-high' : ''}`} data-result=${state} role="status">
    <${Shape} name=${isWrong ? 'high' : 'on'} /><span>${text}</span> <span class="result-figures">${figures}</span>
    ${note && html`<span class="result-note">${note}</span>`}</p>`;
}
