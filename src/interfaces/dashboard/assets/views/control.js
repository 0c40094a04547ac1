// Control: its holder, how another client gets it, and what happens if this browser is lost.

import { html, useEffect } from '../lib.js';
import { ago } from './ago.js';
import { changeTerms, handOver, releaseControl, takeControl } from '../model/commands.js';
import { person, plainSubject } from '../core/people.js';
import { clients } from './clients.js';
import { Force } from './force.js';
import { watchMetrics } from './metrics.js';
import { asks } from './notices.js';
import { t } from '../model/i18n.js';
import { me } from '../model/me.js';
import { myName } from '../model/name.js';
import { onLossHolding, onLossMoving } from '../model/prefs.js';
import { now, others } from '../model/store.js';
import { Covered, Panel, Shape } from '../ui/parts.js';

function Held({ one }) {
  const asked = one.lease.value?.requested_by;
  return html`<p><${Shape} name="lock" /> <strong>${t('control.mine', { name: one.holder.value })}</strong></p>
    ${
      // The user can still hand over after closing the notice.
      asked &&
      !asks(one) &&
      html`<div class="buttons"><button type="button" onClick=${() => handOver(one, asked)}>${t('control.hand_over', {
        name: asked,
      })}</button></div>`
    }
    <div class="buttons"><button type="button" id="give-back"
        onClick=${() => releaseControl(one)}>${t('control.release')}</button></div>`;
}

function OfAnother({ one, holder }) {
  return html`<p><${Shape} name="lock" /> ${t('control.held_by', { holder })}</p>
    ${one.isControlRequested.value && html`<p class="muted" role="status">${t('control.asking', { holder })}</p>`}
    <div class="buttons">
      <button type="button" id="ask-control" onClick=${() => takeControl(one, { request: true })}>${t('control.ask')}
        </button>
      <${Force} one=${one} />
    </div>
    <p class="hint">${t('control.force_hint')}</p>`;
}

function Free({ one }) {
  const reserved = one.reservedFor.value;
  return html`<p>${reserved ? t('control.reserved', { name: reserved }) : t('control.nobody')}</p>
    <div class="buttons"><button type="button" id="take-control" class="primary"
        onClick=${() => takeControl(one)}>${t('control.take')}</button>
    ${reserved && reserved !== myName.value && html`<${Force} one=${one} />`}</div>`;
}

function Terms({ one }) {
  const choose = (signal) => (event) => {
    signal.value = event.currentTarget.value;
    if (one.isMine.peek()) changeTerms(one);
  };
  const terms =
    one.isMine.value && one.lease.value
      ? one.lease.value
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

export function Control({ one }) {
  const holder = one.holder.value;
  return html`<${Panel} title=${t('control.title')} id="control-title" class="control-panel">
    <${Covered}>
      ${
        one.isMine.value
          ? html`<${Held} one=${one} />`
          : holder
            ? html`<${OfAnother} one=${one}
          holder=${holder} />`
            : html`<${Free} one=${one} />`
      }
      <details class="more" open><summary>${t('control.if_gone')}</summary><${Terms} one=${one} /></details>
      <${Others} />
    </${Covered}>
  </${Panel}>`;
}
