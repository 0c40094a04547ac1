// The device: identity, limits, settings, and statistics of its grips.

import { html, useEffect, useRef, useSignal } from '../lib.js';
import { accelerationLimits, asTyped, forceLimits, mistake, number, widthLimits } from '../core/limits.js';
import { fixed, plain, t } from '../model/i18n.js';
import { ask } from '../model/commands.js';
import { mayOperate } from '../model/me.js';
import { ALL_SETTINGS, learnSettings, read } from '../model/reads.js';
import { connection } from '../model/state.js';
import { ConfirmButton } from '../ui/confirm.js';
import { Covered, Panel, Shape, useNewest } from '../ui/parts.js';
import { unknownText } from '../ui/unknown.js';
import { Facts } from '../ui/facts.js';
import { limitsText, NumberField } from '../ui/fields.js';
import { Control } from './control.js';
import { FingerSet } from './finger_set.js';
import { Fingers } from './fingers.js';
import { Flags } from './flags.js';
import { Health } from './health.js';

/** The temperature, or why it is unknown; null for a firmware that does not report it. */
function temperatureText(gripper) {
  if (gripper.temperature.value !== null) return `${fixed(gripper.temperature.value, 1)} °C`;
  if (!gripper.missing.value?.includes('temperature_c')) return null;
  return `– (${unknownText(gripper.state.value, 'temperature_c')})`;
}

function About({ gripper }) {
  const info = gripper.info.value;
  if (!info) return null;
  return html`<${Panel} title=${t('device.title')} id="device-title"><${Facts} facts=${[
    ['device.model', info.device_type],
    ['device.serial', info.serial_number],
    ['device.firmware', info.firmware],
    ['device.hardware', info.hardware_revision],
    ['device.tag', info.device_tag],
    ['device.url', info.url],
    ['device.temperature', temperatureText(gripper)],
    ['device.capabilities', info.capabilities.join(', ')],
    ['device.if_gateway', t(info.stops_on_gateway_loss ? 'device.stops' : 'device.moves_on')],
  ]} /></${Panel}>`;
}

function Limits({ gripper }) {
  const info = gripper.info.value;
  const soft = gripper.softLimits.value;
  return html`<${Panel} title=${t('limits.title')} id="limits-title"><${Facts} facts=${[
    ['limits.stroke', limitsText(widthLimits(info, null), 'mm')],
    [
      'limits.soft',
      soft?.minus_mm == null ? t('limits.no_soft') : `${plain(soft.minus_mm)} – ${plain(soft.plus_mm)} mm`,
    ],
    ['limits.speed', info && `${plain(info.min_speed_mm_s)} – ${plain(info.max_speed_mm_s)} mm/s`],
    ['limits.acceleration', limitsText(accelerationLimits(info), 'mm/s²')],
    ['limits.force', limitsText(forceLimits(info, false), 'N')],
    ['limits.overdrive', info?.overdrive_force_n > info?.nominal_force_n ? `${plain(info.overdrive_force_n)} N` : null],
  ]} /></${Panel}>`;
}

/**
 * Draft of a setting. Follows the device's value until the user types. From then on the draft stays, and `meanwhile`
 * is the value that another client has set.
 */
function useDraft(gripper, field, asText = asTyped) {
  const known = gripper.settings.value;
  const set = field in known ? asText(known[field]) : null;
  const value = useSignal(set ?? '');
  const lastKnown = useRef(set);
  const isOvertaken = useSignal(false);
  useEffect(() => {
    if (set === null) return;
    if (value.peek() === (lastKnown.current ?? '')) value.value = set;
    // The device's first value overtakes no draft.
    else if (lastKnown.current !== null && set !== lastKnown.current) isOvertaken.value = true;
    lastKnown.current = set;
  }, [set]);
  useEffect(() => {
    if (value.value === set) isOvertaken.value = false;
  }, [value.value, set]);
  return {
    key: field,
    value,
    meanwhile: isOvertaken.value && value.value !== set ? set : null,
    follow: () => {
      value.value = set;
    },
  };
}

/** Note that another client has set a value while the user typed, with a button to use that value. */
function Meanwhile({ gripper, drafts }) {
  const overtaken = drafts.filter(({ meanwhile }) => meanwhile !== null);
  if (overtaken.length === 0) return null;
  const by = [...new Set(overtaken.map(({ key }) => gripper.setBy.value[key] ?? '–'))].join(', ');
  return html`<p class="meanwhile small" role="status"><${Shape} name="high" /> ${t('settings.meanwhile', {
    by,
    value: overtaken.map(({ meanwhile, unit = '' }) => `${meanwhile || '–'} ${unit}`.trim()).join(', '),
  })}
    <button type="button" class="quiet" onClick=${() => overtaken.forEach(({ follow }) => follow())}>${t('settings.follow')}
      </button></p>`;
}

/** Form of one setting. */
function Setting({ gripper, id, method, name, fields, limits, send, children }) {
  const wrong = fields.some(({ value, key }) => mistake(number(value.value), limits(key)));
  const set = (event) => {
    event.preventDefault();
    send(`${method}.set`, fields, number);
  };
  return html`<form class="setting" onSubmit=${set}>
    <div class="fields">${fields.map(
      ({ key, label, unit, value }) => html`<${NumberField} key=${key}
        id=${`${id}-${key}`} label=${label} unit=${unit} value=${value} limits=${limits(key)} isOptional=${true} />`,
    )}
          </div>
    <div class="buttons"><button type="submit" aria-label=${`${t('settings.set')}: ${name ?? fields[0].label}`}
        disabled=${wrong}>${t('settings.set')}</button>${children}</div>
    <${Meanwhile} gripper=${gripper} drafts=${fields} />
  </form>`;
}

function Settings({ gripper }) {
  const acceleration = { ...useDraft(gripper, 'acceleration_mm_s2'), label: t('settings.acceleration'), unit: 'mm/s²' };
  const force = { ...useDraft(gripper, 'force_n'), label: t('settings.force_limit'), unit: 'N' };
  const minus = { ...useDraft(gripper, 'minus_mm'), label: t('settings.minus'), unit: 'mm' };
  const plus = { ...useDraft(gripper, 'plus_mm'), label: t('settings.plus'), unit: 'mm' };
  const tag = useDraft(gripper, 'tag', (text) => text ?? '');
  const note = useSignal('');
  useEffect(() => {
    if (!gripper.isThere.value) return;
    learnSettings(gripper, ALL_SETTINGS).then((problem) => {
      if (problem) gripper.problem.value = problem;
    });
  }, [gripper, gripper.isThere.value, connection.value === 'live']);
  const change = async (method, params) => {
    note.value = '';
    const answer = await ask(gripper, method, params);
    if (answer) note.value = t('settings.done');
    return answer;
  };
  const send = async (method, fields, parse) => {
    const take = gripper.askingSettings();
    const answer = await change(method, Object.fromEntries(fields.map(({ key, value }) => [key, parse(value.value)])));
    if (!answer) return;
    take(answer);
    // Another client can have set a newer value.
    const known = gripper.settings.peek();
    fields.forEach(({ key, value }) => {
      value.value = typeof known[key] === 'number' ? asTyped(known[key]) : (known[key] ?? '');
    });
  };
  const hasOverdrive = gripper.info.value?.capabilities.includes('overdrive');
  const isBeforeFirmware4 = Number.parseInt(gripper.info.value?.firmware, 10) < 4;
  const isTag = (isBeforeFirmware4 ? /^[ -~\u00a0-\u00ff]{0,64}$/ : /^[ -~]{0,64}$/).test(tag.value.value);
  const width = widthLimits(gripper.info.value, null);
  const widths = (key) =>
    key === 'minus_mm'
      ? { ...width, max: Math.min(width.max, number(plus.value.value) || width.max) }
      : { ...width, min: Math.max(0, number(minus.value.value) || 0) };
  return html`<${Panel} title=${t('settings.title')} id="settings-title" class="settings-panel">
    <p class="hint">${t('settings.hint')}</p>
    <${Setting} gripper=${gripper} id="acceleration" method="settings.acceleration" send=${send} fields=${[acceleration]}
        limits=${() => accelerationLimits(gripper.info.value)} />
    <${Setting} gripper=${gripper} id="force-limit" method="settings.force-limit" send=${send} fields=${[force]}
        limits=${() => forceLimits(gripper.info.value, gripper.hasOverdrive.value)} />
    <${Setting} gripper=${gripper} id="soft-limits" method="settings.soft-limits" name=${t('limits.soft')} send=${send} fields=${[minus, plus]}
        limits=${widths}><button type="button" aria-label=${`${t('settings.clear')}: ${t('limits.soft')}`}
            disabled=${gripper.softLimits.value.minus_mm === null}
            onClick=${() => change('settings.soft-limits.clear')}>${t('settings.clear')}</button></${Setting}>
    <form class="setting" onSubmit=${(event) => {
      event.preventDefault();
      send('settings.device-tag.set', [tag], String);
    }}>
      <div class=${`field ${isTag ? '' : 'wrong'}`}><label for="tag">${t('settings.tag')}</label><input id="tag"
          type="text" maxlength="64" aria-invalid=${isTag ? 'false' : 'true'} aria-describedby="tag-hint"
              value=${tag.value.value} onInput=${(event) => {
                tag.value.value = event.currentTarget.value;
              }} /><p class="hint"
                  id="tag-hint">${t('settings.tag_hint')}</p></div>
      <div class="buttons"><button type="submit" aria-label=${`${t('settings.set')}: ${t('settings.tag')}`}
          disabled=${!isTag}>${t('settings.set')}</button></div>
      <${Meanwhile} gripper=${gripper} drafts=${[tag]} />
    </form>
    <div class="buttons">
      ${
        hasOverdrive &&
        html`<button type="button" aria-pressed=${gripper.hasOverdrive.value ? 'true' : 'false'}
          onClick=${() => change('settings.overdrive.set', { enabled: !gripper.hasOverdrive.value })}>${t('settings.overdrive')}: ${t(gripper.hasOverdrive.value ? 'settings.off' : 'settings.on')}
                </button>`
      }
      <button type="button" onClick=${() => change('tare')}>${t('settings.tare')}</button>
    </div>
    <p class="small" role="status">${note.value}</p>
  </${Panel}>`;
}

function Statistics({ gripper }) {
  const [known, asking] = useNewest();
  useEffect(() => {
    read('statistics', gripper).then(asking(), () => {});
  }, [gripper, gripper.changes.value, gripper.isThere.value, connection.value === 'live']);
  const figures = known.value;
  const good =
    figures && figures.total > 0 ? ((figures.total - figures.no_part - figures.lost_part) / figures.total) * 100 : null;
  const reset = async () => {
    const take = asking();
    const answer = await ask(gripper, 'statistics.reset');
    if (answer) take(answer);
  };
  return html`<${Panel} title=${t('statistics.title')} id="statistics-title"
      actions=${html`<${ConfirmButton} id="statistics-reset" isAtEnd=${true} label=${t('statistics.reset')} sureLabel=${t('statistics.sure')} act=${reset} />`}>
    <${Facts} facts=${[
      ['statistics.total', plain(figures?.total)],
      ['statistics.no_part', plain(figures?.no_part)],
      ['statistics.lost_part', plain(figures?.lost_part)],
      ['statistics.good', good === null ? '–' : `${fixed(good, 1)} %`],
    ]} />
  </${Panel}>`;
}

export function Device({ gripper }) {
  return html`<div class="device"><${Covered} gripper=${gripper}><div class="column"><${About} gripper=${gripper} /><${Limits}
      gripper=${gripper} /><${Statistics} gripper=${gripper} /><${Health} gripper=${gripper} /></div><div class="column"><${Settings}
      gripper=${gripper} /><${FingerSet} gripper=${gripper} /><${Fingers} gripper=${gripper} /></div></${Covered}>
    <div class="column"><${Flags} gripper=${gripper} />${mayOperate(gripper.name) && html`<${Control} gripper=${gripper} />`}</div></div>`;
}
