// Terms of control: what happens if this browser is lost, and which other clients are active.

import { html, useEffect } from '../lib.js';
import { ago } from '../ui/ago.js';
import { changeTerms } from '../model/commands.js';
import { person, plainSubject } from '../core/people.js';
import { clients } from '../model/clients.js';
import { watchMetrics } from '../model/metrics.js';
import { t } from '../model/i18n.js';
import { me } from '../model/me.js';
import { myName } from '../model/name.js';
import { onLossHolding, onLossMoving } from '../model/prefs.js';
import { now, others } from '../model/state.js';
import { Panel } from '../ui/parts.js';

function Terms({ gripper }) {
  const choose = (signal) => (event) => {
    signal.value = event.currentTarget.value;
    if (gripper.isMine.peek()) changeTerms(gripper);
  };
  const terms =
    gripper.isMine.value && gripper.lease.value
      ? gripper.lease.value
      : { on_loss_moving: onLossMoving.value, on_loss_holding: onLossHolding.value };
  return html`<p class="small">${t(`gone.moving.${terms.on_loss_moving}`)} ${t(`gone.holding.${terms.on_loss_holding}`)} ${t('gone.link')}
    </p>
    <div class="fields terms">
      <div class="field"><label for="on-moving">${t('control.on_moving')}</label><select id="on-moving"
          value=${onLossMoving.value} onChange=${choose(onLossMoving)}>
        ${['fast_stop', 'stop', 'finish'].map(
          (choice) => html`<option value=${choice}>${t(`loss.${choice}`)}
          </option>`,
        )}</select></div>
      <div class="field"><label for="on-holding">${t('control.on_holding')}</label><select id="on-holding"
          value=${onLossHolding.value} onChange=${choose(onLossHolding)}>
        ${['keep', 'fast_stop'].map((choice) => html`<option value=${choice}>${t(`loss.${choice}`)}</option>`)}
          </select></div>
    </div>`;
}

/** Whether a client is this page: other browsers can have its user's name, but not also its address. */
function isThisBrowser({ subject, label }) {
  const mine = me.value?.subject;
  return label === myName.value && mine !== undefined && plainSubject(mine) === plainSubject(subject);
}

function Others() {
  useEffect(watchMetrics, []);
  // Reading the clock refreshes the list and its ages every second.
  const list = now.value && [...others].reverse().slice(0, 6);
  return html`<h3>${t('control.others')}</h3>
    <p class="small">${t('control.connections', {
      list: clients.value.map(({ door, count }) => `${t(`door.${door}`)} ${count}`).join(', ') || '–',
    })}</p>
    <ul class="others small">${list.map(([key, other]) => {
      const who = person(other.subject, other.label);
      return html`<li key=${key}><span>${isThisBrowser(other) ? t('latch.you', { who }) : who}</span> <span
        class="muted">${t(`door.${other.door}`)}, ${ago(other.at)}</span></li>`;
    })}</ul>`;
}

/** Terms of the lease for the case that this browser is lost, and the other clients. */
export function Control({ gripper }) {
  return html`<${Panel} title=${t('control.if_gone')} id="terms-title" class="control-panel">
    <${Terms} gripper=${gripper} />
    <${Others} />
  </${Panel}>`;
}
