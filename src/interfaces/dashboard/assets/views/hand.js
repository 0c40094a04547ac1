// Values by hand: the fields for Grip, Release and Move, which can become a recipe.

import { effect, html, useEffect, useSignal } from '../lib.js';
import { forceLimits, mistake, number, speedLimits, widthLimits } from '../core/limits.js';
import { move } from '../model/commands.js';
import { defaultOpen, handOf } from '../model/hand.js';
import { plain, t } from '../model/i18n.js';
import { recipes } from '../model/recipes.js';
import { whyNot } from '../model/steps.js';
import { NumberField } from '../ui/fields.js';
import { MAX_PART_BYTES, within } from '../ui/parts.js';

function Select({ id, label, value, options, textOf }) {
  return html`<div class="field"><label for=${id}>${label}</label><select id=${id} value=${value.value}
      onChange=${(event) => {
        value.value = event.currentTarget.value;
      }}>${options.map((option) => html`<option key=${option} value=${option}>${textOf(option)}</option>`)}</select></div>`;
}

/** `onSave` is called with the values for a new recipe; null if this person may not save one. */
export function ByHand({ gripper, onSave }) {
  const hand = handOf(gripper);
  const width = widthLimits(gripper.info.value, gripper.softLimits.value);
  const speed = speedLimits(gripper.info.value);
  const force = forceLimits(gripper.info.value, gripper.hasOverdrive.value);
  const isOpen = useSignal(null);
  const isNew = recipes.value !== null && recipes.value.length === 0;
  // Open fields stay open when the first recipe comes.
  useEffect(() => {
    if (isNew) isOpen.value ??= true;
  }, [isNew]);
  const isShown = isOpen.value ?? isNew;
  const width_mm = number(hand.width.value);
  const speed_mm_s = number(hand.speed.value);
  const isWrong = Boolean(mistake(width_mm, width) || mistake(speed_mm_s, speed));
  useEffect(() => {
    // A person who types a value means this value, and no recipe.
    const typed = [hand.width, hand.speed, hand.force, hand.part];
    let before = typed.map((value) => value.peek()).join('\n');
    return effect(() => {
      const now = typed.map((value) => value.value).join('\n');
      if (now !== before) hand.chosen.value = null;
      before = now;
    });
  }, [gripper]);
  return html`<details id="by-hand" class="more by-hand" open=${isShown} onToggle=${({ currentTarget }) => {
    if (currentTarget.open !== isShown) isOpen.value = currentTarget.open;
  }}><summary>${t('hand.title')}</summary>
    <div class="fields">
      <${NumberField} id="width" label=${t('field.width')} unit="mm" value=${hand.width} limits=${width} />
      <${NumberField} id="open" label=${t('field.open')} unit="mm" value=${hand.open} limits=${width}
          isOptional=${true} whenEmpty=${t('field.open_empty', { width: plain(defaultOpen(gripper, hand.width)) })} />
      <${NumberField} id="speed" label=${t('speed')} unit="mm/s" value=${hand.speed} limits=${speed} />
      <${NumberField} id="force" label=${t('field.force')} unit="N" value=${hand.force} limits=${force}
          isOptional=${true} whenEmpty=${t('field.force_empty', { force: plain(gripper.settings.value.force_n) })} />
      <div class="field"><label for="part">${t('field.part')}</label>
        <div class="input"><input id="part" type="text" autocomplete="off" value=${hand.part.value}
            onInput=${within(MAX_PART_BYTES, (text) => {
              hand.part.value = text;
            })} /></div>
        <p class="hint">${t('field.part_hint')}</p></div>
      <${Select} id="direction" label=${t('field.direction')} value=${hand.direction}
          options=${['default', 'outer', 'inner']} textOf=${(option) => t(`direction.${option}`)} />
      <${Select} id="block" label=${t('field.block')} value=${hand.block} options=${['stop', 'clamp']} textOf=${(option) => t(`block.${option}`)} />
    </div>
    <div class="buttons">
      <button type="button" id="move" disabled=${whyNot(gripper) !== null || isWrong} onClick=${() =>
        move(gripper, 'move', { width_mm, speed_mm_s, on_block: hand.block.value })}>${t('hand.move', {
        width: plain(width_mm),
      })}</button>
      ${onSave && html`<button type="button" id="hand-save" disabled=${isWrong} onClick=${onSave}>${t('hand.save')}</button>`}
    </div>
  </details>`;
}
