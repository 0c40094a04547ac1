// Result of the newest grip or motion, in large type beside the jaws.

import { html } from '../lib.js';
import { FLAGS, isSet } from '../core/flags.js';
import { isGrip } from '../core/kinds.js';
import { fixed, plain, t } from '../model/i18n.js';
import { Shape } from './parts.js';
import { steered } from './steered.js';

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

/** Whether an outcome is the wanted one. */
export const isGood = (outcome) => GOOD.includes(outcome);

/** Difference from the expected width up to which a held part gets no note. */
const TOLERANCE_MM = 2;

/** Whether a command has ended without success. */
export const hasFailed = ({ phase, outcome }) => phase !== 'running' && Boolean(outcome) && !isGood(outcome);

function early(command, width) {
  const aim = isGrip(command?.kind) ? command.aim_mm : null;
  return aim == null || width == null || Math.abs(width - aim) <= TOLERANCE_MM
    ? null
    : t('result.early', { aim: plain(aim) });
}

/** Whether the gripper reports ERROR without a fault. Firmware 4 does from a FAST STOP until the next motion. */
function hasNoFault(gripper) {
  const flags = gripper.flags.value;
  return gripper.gripperState.value === 'ERROR' && flags !== null && !FAULTS.some(({ bit }) => isSet(flags, bit));
}

/** Whether the gripper still reports an error, although somebody has acknowledged it, and accepts motions. */
export const isAcknowledged = (gripper) =>
  hasNoFault(gripper) && ![VALUE_UNKNOWN, DEVICE_ERROR].includes(gripper.faultCode.value);

function resultOf(gripper) {
  const command = gripper.command.value;
  const state = gripper.gripperState.value;
  if (gripper.latchId.value || command?.phase === 'running') return null;
  if (state === HELD) {
    // The newest command can be a Stop, which does not change the grip's result.
    if (gripper.outcomeCode.value === WRONG_PART_CODE) {
      const contact = command?.outcome === WRONG_PART ? command.contact_width_mm : null;
      const note = contact === null ? null : t('result.contact', { width: fixed(contact, 2) });
      return { state: WRONG_PART, isWrong: true, text: t('result.wrong_part'), note };
    }
    // `reading` is read only in this state, so that moving fingers do not render the result again.
    return { state, text: t('result.held'), note: early(command, gripper.reading.value?.width_mm) };
  }
  if (hasNoFault(gripper)) {
    if (gripper.faultCode.value === VALUE_UNKNOWN) return { state, isWrong: true, text: t('result.error') };
    const isOpen = gripper.faultCode.value === DEVICE_ERROR;
    const note = t(isOpen ? 'result.open' : 'result.ready');
    return { state, isWrong: isOpen, text: t('result.error'), note };
  }
  if (FAILED.includes(state)) return { state, isWrong: true, text: t(`state.${state}`) };
  if (!command || !hasFailed(command)) return null;
  const at = command.width_mm == null ? null : t('result.at', { width: fixed(command.width_mm, 2) });
  const text = `${t(`command.${command.kind}`)}: ${t(`outcome.${command.outcome}`)}`;
  return { state: command.outcome, isWrong: true, text, note: at };
}

/** Forms of the states that a person has to tell apart from three metres. */
const FORMS = { HOLDING: 'held', NO_PART: 'empty', PART_LOST: 'lost' };

/**
 * The result of a grip, or without one the client that steers the fingers or the gripper's state, in the same place.
 * `children` are the words of the state.
 */
export function Result({ gripper, children }) {
  const result = resultOf(gripper);
  if (!result && gripper.latchId.value !== null)
    return html`<p class="outcome halted"><${Shape} name="critical" /><span class="outcome-word">${children}</span></p>`;
  const steering = steered(gripper);
  if (!result && steering)
    return html`<p class="outcome steered"><span class="outcome-word">${steering.who}</span>
    <span class="result-note">${steering.how}</span></p>`;
  if (!result) return html`<p class="outcome">${children}</p>`;
  const { state, isWrong, text, note } = result;
  return html`<p class=${`outcome result ${FORMS[state] ?? ''} ${isWrong ? 'tone-high' : ''}`} data-result=${state} role="status">
    <${Shape} name=${FORMS[state] ?? (isWrong ? 'high' : 'on')} /><span class="outcome-word">${text}</span>
    <span class="result-note">${steering ? `${steering.who}: ${steering.how}` : (note ?? '')}</span></p>`;
}
