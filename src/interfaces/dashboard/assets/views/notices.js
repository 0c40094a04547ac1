// Notices below the bar, in every view: requests for control, loss of control, a reservation, refusals, and the worst
// alarm.

import { html, signal, useEffect, useRef } from '../lib.js';
import { isActive, isOpen, sorted } from '../core/alarms.js';
import { alarmName } from './alarm.js';
import { Force } from './force.js';
import { noteMove } from './shield.js';
import './title.js';
import { alarms } from '../model/alarms.js';
import { handOver, takeControl } from '../model/commands.js';
import { ofProblem, t } from '../model/i18n.js';
import { myName } from '../model/name.js';
import { gripper, grippers, isLive, view } from '../model/store.js';
import { Shape } from '../ui/parts.js';

const MAX_CLOSED = 50;

/** Keys of notices that the user closed. */
const closed = signal([]);

const close = (key) => {
  closed.value = [...closed.peek(), key].slice(-MAX_CLOSED);
};

const askedKey = (one, name) => `${one.name}/asked/${one.lease.value.epoch}/${name}`;

/** Name of the client that asks this page for control, unless the user has closed the notice; null for none. */
export function asks(one) {
  const name = one.isMine.value ? one.lease.value?.requested_by : null;
  return name && !closed.value.includes(askedKey(one, name)) ? name : null;
}

function Notice({ kind, tone = 'tone-high', shape = 'high', role = 'status', text, detail = '', children }) {
  return html`<div class=${`notice ${tone}`} data-notice=${kind} role=${role}><${Shape} name=${shape} />
    <p>${text}${detail && html` <span class="small" lang="en">${detail}</span>`}</p>
    <div class="buttons">${children}</div></div>`;
}

function Close({ label, name, onClick }) {
  return html`<button type="button" class="quiet" aria-label=${`${label}: ${name}`} onClick=${onClick}>${label}</button>`;
}

function Asked({ one }) {
  const name = asks(one);
  if (!name) return null;
  return html`<${Notice} kind="asked" text=${t('notice.asked', { name, gripper: one.name })}>
    <button type="button" id="hand-over" class="primary" aria-label=${t('notice.hand_over_of', {
      name,
      gripper: one.name,
    })} onClick=${() => handOver(one, name)}>${t('notice.hand_over')}</button>
    <${Close} label=${t('notice.not_now')} name=${`${name}, ${one.name}`}
        onClick=${() => close(askedKey(one, name))} /></${Notice}>`;
}

function Lost({ one }) {
  const lost = one.lostControl.value;
  if (!lost) return null;
  return html`<${Notice} kind="lost" role="alert" text=${t(`notice.${lost.how}`, {
    name: lost.by ?? '',
    gripper: one.name,
  })}>
    <${Close} label=${t('close')} name=${one.name} onClick=${() => {
      one.lostControl.value = null;
    }} /></${Notice}>`;
}

function Reserved({ one }) {
  const name = one.reservedFor.value;
  const key = `${one.name}/reserved/${one.lease.value?.epoch}`;
  if (!name || closed.value.includes(key)) return null;
  return html`<${Notice} kind="reserved" text=${t('notice.reserved', { name, gripper: one.name })}>
    ${
      name === myName.value
        ? html`<button type="button" class="primary" aria-label=${`${t('control.take')}: ${one.name}`}
            onClick=${() => takeControl(one)}>${t('control.take')}</button>`
        : html`<${Force} one=${one} place="notice-" of=${`: ${one.name}`} />`
    }
    <${Close} label=${t('notice.not_now')} name=${one.name} onClick=${() => close(key)} /></${Notice}>`;
}

function Refused({ one }) {
  const problem = one.problem.value;
  if (!problem) return null;
  return html`<${Notice} kind="problem" role="alert" tone="problem" text=${`${one.name}: ${ofProblem(problem)}`}
      detail=${problem.detail}>
    <${Close} label=${t('close')} name=${`${t('notice.refusal')}, ${one.name}`} onClick=${() => {
      one.problem.value = null;
    }} /></${Notice}>`;
}

/** Whether the view already shows the alarm elsewhere: a lost connection, a FAST STOP, unknown values, or a reservation. */
function isShown({ alarm, gripper: name }) {
  if (alarm === 'no_gateway') return true;
  if (name !== gripper.value?.name) return false;
  const ofView = ['fast_stop', 'not_reached', 'link_down', 'link_released', 'value_unknown'];
  return alarm === 'holder_lost' || (view.value === 'operate' && ofView.includes(alarm));
}

function Worst() {
  const open = sorted(alarms.value).filter((alarm) => isOpen(alarm) && isActive(alarm) && !isShown(alarm));
  if (open.length === 0) return null;
  const [worst] = open;
  return html`<${Notice} kind="alarm" tone=${`tone-${worst.priority}`} shape=${worst.priority}
    text=${open.length === 1 ? alarmName(worst) : t('notice.more', { alarm: alarmName(worst), count: open.length - 1 })} />`;
}

export function Notices() {
  const place = useRef(null);
  useEffect(() => {
    let isFirst = true;
    const resized = new ResizeObserver(() => {
      if (!isFirst) noteMove(place.current);
      isFirst = false;
    });
    resized.observe(place.current);
    return () => resized.disconnect();
  }, []);
  return html`<section class="notices" ref=${place} aria-label=${t('notice.label')}>
    ${
      isLive.value &&
      grippers.value.map(
        (one) => html`<${Asked} key=${`${one.name}-asked`} one=${one} /><${Lost} key=${`${one.name}-lost`}
            one=${one} /><${Refused} key=${`${one.name}-refused`} one=${one} />`,
      )
    }
    ${isLive.value && gripper.value && html`<${Reserved} one=${gripper.value} />`}
    <${Worst} />
  </section>`;
}
