// Holder of control, with the buttons to take it, to ask for it and to give it up.

import { html, signal, useEffect, useRef } from '../lib.js';
import { handOver, releaseControl, takeControl } from '../model/commands.js';
import { t } from '../model/i18n.js';
import { isUnnamed, MAX_NAME_BYTES, holderName, rename } from '../model/name.js';
import { stepOf } from '../model/steps.js';
import { ConfirmButton } from '../ui/confirm.js';
import { Covered, Panel, within } from '../ui/parts.js';

/** Function that waits for the person's name, or null. */
const waiting = signal(null);

/** Does something that others see with the person's name, which is asked for once. */
function withName(act) {
  if (isUnnamed.peek()) waiting.value = act;
  else act();
}

function YourName() {
  const field = useRef(null);
  useEffect(() => field.current.focus(), []);
  const submit = (event) => {
    event.preventDefault();
    const act = waiting.peek();
    rename(field.current.value);
    if (isUnnamed.peek()) return;
    waiting.value = null;
    act();
  };
  return html`<form class="your-name" onSubmit=${submit}><label for="your-name">${t('control.your_name')}</label>
    <div class="buttons"><input id="your-name" ref=${field} type="text" autocomplete="name" required
        onInput=${within(MAX_NAME_BYTES, () => {})} /><button type="submit" id="your-name-set" class="primary">${t(
          'control.name_set',
        )}</button><button type="button" id="your-name-cancel" class="quiet" aria-label=${t('cancel')}
        onClick=${() => {
          waiting.value = null;
        }}>×</button></div></form>`;
}

function Buttons({ gripper }) {
  const holder = gripper.holder.value;
  const reserved = gripper.reservedFor.value;
  const name = (key) => `${t(key)}: ${gripper.name}`;
  if (gripper.isMine.value) {
    const asked = gripper.lease.value?.requested_by;
    return html`<button type="button" id="give-back" aria-label=${name('control.release')}
        onClick=${() => releaseControl(gripper)}>${t('control.release')}</button>${
          asked &&
          html`<button type="button" id="hand-over-here" aria-label=${`${t('control.hand_over', { name: asked })}: ${gripper.name}`}
              onClick=${() => handOver(gripper, asked)}>${t('notice.hand_over')}</button>`
        }`;
  }
  const force = html`<${ConfirmButton} id="force-control" label=${t('control.force')} sureLabel=${t('control.force_sure')}
      topic=${`${gripper.name}/${gripper.state.value?.lease_epoch}`} act=${() => withName(() => takeControl(gripper, { force: true }))} />`;
  if (holder)
    return html`<button type="button" id="ask-control" class="primary" aria-label=${name('control.ask')}
        disabled=${gripper.isControlRequested.value}
        onClick=${() => withName(() => takeControl(gripper, { request: true }))}>${t('control.ask')}</button>${force}`;
  if (reserved && reserved !== holderName.value) return force;
  return html`<button type="button" id="take-control" class="primary" aria-label=${name('control.take')}
      onClick=${() => withName(() => takeControl(gripper))}>${t(reserved ? 'control.take_back' : 'control.take')}</button>`;
}

function textOf(gripper) {
  const holder = gripper.holder.value;
  const reserved = gripper.reservedFor.value;
  if (gripper.isMine.value) return t('control.mine', { name: holder });
  if (holder) return t(gripper.isControlRequested.value ? 'control.asking' : 'control.held_by', { holder });
  if (reserved === null) return t('control.nobody');
  return t(reserved === holderName.value ? 'control.reserved_mine' : 'control.reserved', { name: reserved });
}

export function WhoControls({ gripper }) {
  const isAsked = waiting.value !== null && !gripper.isMine.value;
  return html`<${Panel} title=${t('control.title')} id="control-title" class="who-panel take">
    <${Covered} gripper=${gripper}>${
      isAsked
        ? html`<${YourName} />`
        : html`<p data-step=${stepOf(gripper)}>${textOf(gripper)}</p><div class="buttons"><${Buttons} gripper=${gripper} /></div>`
    }</${Covered}>
  </${Panel}>`;
}
