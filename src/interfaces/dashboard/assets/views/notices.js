// Notices of the strip, in every view: requests for control, loss of control, a reservation, refusals, the worst alarm,
// and the next step.

import { html, signal } from '../lib.js';
import { isActive, isOpen, PRIORITIES, sorted } from '../core/alarms.js';
import { alarmName, showAlarm } from '../ui/alarm.js';
import { ConfirmButton } from '../ui/confirm.js';
import { whyOld } from '../ui/parts.js';
import { addNotices } from '../ui/strip.js';
import '../ui/shield.js';
import './title.js';
import { alarms } from '../model/alarms.js';
import { handOver, takeControl } from '../model/commands.js';
import { breakable, ofProblem, t } from '../model/i18n.js';
import { mayOperate } from '../model/me.js';
import { isUnnamed, holderName } from '../model/name.js';
import { stepOf } from '../model/steps.js';
import { shownGripper, grippers, isLive, view } from '../model/state.js';
import { isOld } from '../model/version.js';
import { go } from '../ui/route.js';

const MAX_CLOSED = 50;

/** Ranks of notices below those of FAST STOPs. */
const RANK = { refused: 20, lost: 30, asked: 40, critical: 50, high: 60, reserved: 70, low: 80, old: 85, next: 90 };

/** Keys of notices that the user closed. */
const closed = signal([]);

const close = (key) => {
  closed.value = [...closed.peek(), key].slice(-MAX_CLOSED);
};

function asked(gripper) {
  const name = gripper.isMine.value ? gripper.lease.value?.requested_by : null;
  const key = `${gripper.name}/asked/${gripper.lease.value?.epoch}/${name}`;
  if (!name || closed.value.includes(key)) return null;
  return {
    key,
    rank: RANK.asked,
    kind: 'asked',
    tone: 'tone-high',
    shape: 'high',
    text: t('notice.asked', { name, gripper: gripper.name }),
    buttons: html`<button type="button" id="hand-over" class="primary" aria-label=${t('notice.hand_over_of', {
      name,
      gripper: gripper.name,
    })} onClick=${() => handOver(gripper, name)}>${t('notice.hand_over')}</button>`,
    close: () => close(key),
    closeLabel: t('notice.not_now'),
    closeName: `${name}, ${gripper.name}`,
  };
}

function lost(gripper) {
  const how = gripper.lostControl.value;
  if (!how) return null;
  return {
    key: `${gripper.name}/lost`,
    rank: RANK.lost,
    kind: 'lost',
    tone: 'tone-high',
    shape: 'high',
    role: 'alert',
    text: t(`notice.${how.how}`, { name: how.by ?? '', gripper: gripper.name }),
    close: () => {
      gripper.lostControl.value = null;
    },
    closeLabel: t('close'),
    closeName: gripper.name,
  };
}

function refused(gripper) {
  const problem = gripper.problem.value;
  if (!problem) return null;
  return {
    key: `${gripper.name}/problem/${problem.code}`,
    rank: RANK.refused,
    kind: 'problem',
    tone: 'problem',
    shape: 'high',
    role: 'alert',
    text: `${breakable(gripper.name)}: ${ofProblem(problem)}`,
    title: problem.detail,
    close: () => {
      gripper.problem.value = null;
    },
    closeLabel: t('close'),
    closeName: `${t('notice.refusal')}, ${gripper.name}`,
  };
}

function reserved(gripper) {
  const name = gripper.reservedFor.value;
  const isMine = name !== null && name === holderName.value;
  const key = `${gripper.name}/reserved/${gripper.lease.value?.epoch}`;
  if (!name || closed.value.includes(key)) return null;
  return {
    key,
    rank: RANK.reserved,
    kind: 'reserved',
    tone: 'tone-high',
    shape: 'high',
    text: t(isMine ? 'notice.reserved_mine' : 'notice.reserved', { name, gripper: gripper.name }),
    buttons: isMine
      ? html`<button type="button" id="take-back" class="primary" aria-label=${`${t('control.take_back')}: ${gripper.name}`}
            onClick=${() => takeControl(gripper)}>${t('control.take_back')}</button>`
      : html`<${ConfirmButton} id="notice-force-control" isAtEnd=${true} label=${t('control.force')} sureLabel=${t('control.force_sure')}
            of=${`: ${gripper.name}`} topic=${`${gripper.name}/${gripper.state.value?.lease_epoch}`}
            act=${() => takeControl(gripper, { force: true })} />`,
    close: () => close(key),
    closeLabel: t('notice.not_now'),
    closeName: gripper.name,
  };
}

/** Whether the view already shows the alarm: a lost link or part, a FAST STOP, unknown values, or a reservation. */
function isShown({ alarm, gripper: name }) {
  if (alarm === 'no_gateway') return true;
  if (name !== shownGripper.value?.name) return false;
  const ofView = ['fast_stop', 'part_lost', 'not_reached', 'link_down', 'link_released', 'value_unknown'];
  return alarm === 'holder_lost' || (view.value === 'operate' && ofView.includes(alarm));
}

function worstAlarm() {
  const open = sorted(alarms.value).filter((alarm) => isOpen(alarm) && isActive(alarm) && !isShown(alarm));
  if (open.length === 0) return [];
  const [worst] = open;
  return [
    {
      key: `alarm/${worst.id}/${open.length}`,
      rank: RANK[worst.priority] ?? RANK.low,
      kind: 'alarm',
      tone: `tone-${worst.priority}`,
      shape: PRIORITIES.includes(worst.priority) ? worst.priority : 'low',
      text:
        open.length === 1 ? alarmName(worst) : t('notice.more', { alarm: alarmName(worst), count: open.length - 1 }),
      buttons: html`<button type="button" id="show-worst" aria-label=${`${t('notice.show')}: ${alarmName(worst)}`}
          onClick=${() => showAlarm(worst)}>${t('notice.show')}</button>`,
    },
  ];
}

function newer() {
  if (!isOld.value) return [];
  return [
    {
      key: 'newer',
      rank: RANK.old,
      kind: 'newer',
      shape: 'low',
      text: t('newer'),
      buttons: html`<button type="button" onClick=${() => location.reload()}>${t('reload')}</button>`,
    },
  ];
}

/** Buttons that lead to the next step. Motions begin only with the buttons beside the jaws. */
function nextButtons(gripper) {
  if (view.value === 'operate') return null;
  return html`<button type="button" id="to-operate" aria-label=${`${t('nav.operate')}: ${gripper.name}`} onClick=${() => go('operate')}>${t('nav.operate')}</button>`;
}

function next(gripper) {
  const step = mayOperate(gripper.name) ? stepOf(gripper) : 'watch';
  const old = whyOld(gripper);
  const text =
    step === 'wait'
      ? (old?.text ?? t('stale.connecting'))
      : t(`next.${step === 'take' && isUnnamed.value ? 'take_named' : step}`, {
          holder: gripper.holder.value ?? '',
          name: gripper.reservedFor.value ?? '',
        });
  return {
    key: `next/${gripper.name}/${step}`,
    rank: RANK.next,
    kind: 'next',
    shape: { acknowledge: 'critical', wait: 'high', running: 'moving', steered: 'moving' }[step] ?? 'next',
    text: grippers.value.length > 1 ? `${breakable(gripper.name)}: ${text}` : text,
    buttons: nextButtons(gripper),
  };
}

addNotices(() => {
  const gripper = shownGripper.value;
  const ofAll = isLive.value ? grippers.value.flatMap((each) => [refused(each), lost(each), asked(each)]) : [];
  const ofShown = gripper ? [isLive.value ? reserved(gripper) : null, next(gripper)] : [];
  return [...ofAll, ...worstAlarm(), ...newer(), ...ofShown].filter(Boolean);
});
