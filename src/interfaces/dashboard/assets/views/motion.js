// Motion controls: home, move, grip, release, stop, within the limits shown beside each field.

import { computed, html, signal, useMemo } from '../lib.js';
import { isGrip } from '../core/kinds.js';
import { asTyped, forceLimits, mistake, number, speedLimits, widthLimits } from '../core/limits.js';
import { fixed, plain, t } from '../model/i18n.js';
import { askFreely, move, releaseControl, takeControl } from '../model/commands.js';
import { isUnnamed, MAX_NAME_BYTES, myName, rename } from '../model/name.js';
import { openTo } from '../model/prefs.js';
import { isLive } from '../model/store.js';
import { Covered, MAX_PART_BYTES, onPress, Panel, Shape, within } from '../ui/parts.js';
import { hasFailed } from '../ui/result.js';
import { stopOne } from '../ui/stop.js';
import { NumberField } from './fields.js';
import { JogPanel } from './jog.js';
import { Latch } from './latch.js';
import { Presets } from './presets.js';

/** Input for each gripper, kept while the page is open. */
const typed = new WeakMap();

/** Distance by which Release opens beyond the part's width, unless the user types another width. */
const OPENS_BY_MM = 10;

/** The part's width plus `OPENS_BY_MM`, within the limits; null while the part's width is not valid. */
function defaultOpen(one, width) {
  const { max } = widthLimits(one.info.value, one.softLimits.value);
  const given = number(width.value);
  return Number.isFinite(given) ? Math.min(given + OPENS_BY_MM, max) : null;
}

/** Text of the field for the width to open to. The browser remembers the user's input. */
function openField(one, width) {
  return {
    get value() {
      return openTo.value[one.name] ?? asTyped(defaultOpen(one, width));
    },
    set value(text) {
      openTo.value = { ...openTo.peek(), [one.name]: text };
    },
  };
}

function fieldsOf(one) {
  if (!typed.has(one)) {
    const width = signal('20');
    typed.set(one, {
      width,
      open: openField(one, width),
      speed: signal('50'),
      force: signal('30'),
      part: signal(''),
      direction: signal('default'),
      block: signal('stop'),
    });
  }
  return typed.get(one);
}

/** Key of the reason why a motion is not possible now, or null. */
export function whyNot(one, needsReference = true) {
  if (!isLive.value || !one.isThere.value) return 'why.link';
  if (one.latchId.value) return 'why.fast_stop';
  if (one.flags.value === null) return 'why.flags';
  if (!one.isMine.value) return 'why.control';
  if (one.runs.value || one.isMotionRequested.value) return 'why.running';
  if (needsReference && !one.isReferenced.value) return 'why.not_referenced';
  return null;
}

/** Asks once for the user's name, which other users see as the holder of control and in a FAST STOP. */
function YourName() {
  return html`<div class="your-name"><label for="your-name">${t('control.your_name')}</label><input id="your-name"
      type="text" autocomplete="name" onInput=${within(MAX_NAME_BYTES, () => {})}
      onChange=${({ currentTarget }) => rename(currentTarget.value)} /></div>`;
}

/** Names the holder of control, and offers to take, request or release control. */
function WhoControls({ one }) {
  const [holder, reserved] = [one.holder.value, one.reservedFor.value];
  const button = (key, act, isMain = false) => html`<button type="button" class=${isMain ? 'primary' : ''}
      aria-label=${`${t(key)}: ${one.name}`} onClick=${act}>${t(key)}</button>`;
  if (one.isMine.value)
    return html`<div class="take taken"><p>${t('control.you')}</p>
      ${button('control.release', () => releaseControl(one))}</div>`;
  if (holder)
    return html`<div class="take"><p>${t(one.isControlRequested.value ? 'control.asking' : 'control.held_by', { holder })}</p>
      ${button('control.ask', () => takeControl(one, { request: true }))}</div>`;
  return html`<div class="take"><p>${reserved ? t('control.reserved', { name: reserved }) : t('control.nobody')}</p>
    ${!reserved && isUnnamed.value && html`<${YourName} />`}
    ${(!reserved || reserved === myName.value) && button('control.take', () => takeControl(one), true)}</div>`;
}

/** Progress or outcome of the newest command. */
function LastCommand({ one }) {
  const command = one.command.value;
  if (!command) return html`<p class="last muted" role="status">${t('last.none')}</p>`;
  const shape = hasFailed(command) ? 'high' : command.outcome ? 'check' : 'moving';
  const measured = [
    command.width_mm != null && `${fixed(command.width_mm, 2)} mm`,
    isGrip(command.kind) && command.force_n != null && `${fixed(command.force_n, 1)} N`,
    command.duration_ms != null && `${fixed(command.duration_ms / 1000, 2)} s`,
  ];
  return html`<p class="last" role="status" data-outcome=${command.outcome ?? 'running'}><${Shape} name=${shape} />
    <strong>${t(`command.${command.kind}`)}
      </strong> ${command.outcome ? t(`outcome.${command.outcome}`) : t('outcome.running')}
    <span class="muted">${command.phase === 'done' || command.outcome ? measured.filter(Boolean).join(' · ') : ''}
      </span></p>`;
}

function Controls({ one }) {
  const fields = fieldsOf(one);
  const limits = useMemo(
    () => ({
      width: computed(() => widthLimits(one.info.value, one.softLimits.value)),
      speed: computed(() => speedLimits(one.info.value)),
      force: computed(() => forceLimits(one.info.value, one.hasOverdrive.value)),
    }),
    [one],
  );
  const values = {
    width_mm: number(fields.width.value),
    open_mm: fields.open.value.trim() === '' ? defaultOpen(one, fields.width) : number(fields.open.value),
    speed_mm_s: number(fields.speed.value),
    force_n: number(fields.force.value),
  };
  const reason = whyNot(one);
  const homing = whyNot(one, false);
  const wrongSpeed = mistake(values.speed_mm_s, limits.speed.value);
  const wrong = mistake(values.width_mm, limits.width.value) || wrongSpeed;
  const wrongOpen = mistake(values.open_mm, limits.width.value) || wrongSpeed;
  const wrongForce = fields.force.value.trim() !== '' && mistake(values.force_n, limits.force.value);
  const path = { width_mm: values.width_mm, speed_mm_s: values.speed_mm_s };
  const grip = () =>
    move(one, 'grip', {
      ...path,
      ...(fields.force.value.trim() === '' ? {} : { force_n: values.force_n }),
      ...(fields.part.value === '' ? {} : { part_id: fields.part.value }),
    });
  const shown = reason ?? (wrong || wrongOpen || wrongForce ? 'why.limits' : null);
  return html`<div class="controls">
    <div class="fields">
      <${NumberField} id="width" label=${t('field.width')} unit="mm" value=${fields.width}
          limits=${limits.width.value} />
      <${NumberField} id="open" label=${t('field.open')} unit="mm" value=${fields.open} limits=${limits.width.value}
          isOptional=${true} whenEmpty=${t('field.open_empty', { width: plain(defaultOpen(one, fields.width)) })} />
      <${NumberField} id="speed" label=${t('speed')} unit="mm/s" value=${fields.speed} limits=${limits.speed.value} />
      <${NumberField} id="force" label=${t('field.force')} unit="N" value=${fields.force} limits=${limits.force.value}
          isOptional=${true} whenEmpty=${t('field.force_empty', { force: plain(one.settings.value.force_n) })} />
      <div class="field"><label for="part">${t('field.part')}</label>
        <div class="input"><input id="part" type="text" autocomplete="off" value=${fields.part.value}
            onInput=${within(MAX_PART_BYTES, (text) => {
              fields.part.value = text;
            })} /></div>
        <p class="hint">${t('field.part_hint')}</p></div>
    </div>
    <div class="buttons">
      <button type="button" id="grip" class="primary" disabled=${reason || wrong || wrongForce}
          onClick=${grip}>${t('command.grip')}</button>
      <button type="button" id="release" disabled=${reason || wrongOpen} onClick=${() =>
        move(one, 'release', { ...path, width_mm: values.open_mm })}>${t('command.release')}</button>
      <button type="button" id="move" disabled=${reason || wrong} onClick=${() =>
        move(one, 'move', { ...path, on_block: fields.block.value })}>${t('command.move')}</button>
      <button type="button" id="home" disabled=${homing} onClick=${() =>
        move(one, 'home', { direction: fields.direction.value })}>${t('command.home')}</button>
    </div>
    <p class="why muted small" role="status">${
      shown
        ? t(shown)
        : t('why.ready', {
            width: plain(values.width_mm),
            open: plain(values.open_mm),
          })
    }</p>
    <${JogPanel} one=${one} speed=${fields.speed} limits=${limits} reason=${reason} />
    <${Presets} one=${one} fields=${fields} />
    <details class="more"><summary>${t('field.more')}</summary><div class="fields">
      <div class="field"><label for="direction">${t('field.direction')}</label><select id="direction"
          value=${fields.direction.value}
              onChange=${(event) => {
                fields.direction.value = event.currentTarget.value;
              }}>
        ${['default', 'outer', 'inner'].map(
          (direction) => html`<option
            value=${direction}>${t(`direction.${direction}`)}</option>`,
        )}</select></div>
      <div class="field"><label for="block">${t('field.block')}</label><select id="block" value=${fields.block.value}
          onChange=${(event) => {
            fields.block.value = event.currentTarget.value;
          }}>
        ${['stop', 'clamp'].map((block) => html`<option value=${block}>${t(`block.${block}`)}</option>`)}</select></div>
    </div></details>
  </div>`;
}

export function Motion({ one }) {
  const isLatched = one.latchId.value !== null;
  const actions = html`<button type="button" id="stop-soft" disabled=${!isLive.value} onClick=${() =>
    askFreely(one, 'stop')}>${t('command.stop')}</button>
    <button type="button" id="stop-one" class="at-once" ...${onPress(() => stopOne(one))}>${t('motion.fast_stop', {
      gripper: one.name,
    })}</button>`;
  return html`<${Panel} title=${t('motion.title')} id="motion-title" class="motion-panel" actions=${actions}>
    <${Covered} one=${one}>
      ${
        isLatched
          ? html`<${Latch} one=${one} />`
          : html`
        <${WhoControls} one=${one} />
        <${Controls} one=${one} />`
      }
      <${LastCommand} one=${one} />
    </${Covered}>
  </${Panel}>`;
}
