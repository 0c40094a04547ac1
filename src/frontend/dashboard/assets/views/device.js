// The device: what it is, what it can do, what it is set to, and how its grips went.

import { html, useEffect, useSignal } from '../lib.js';
import { accelerationLimits, forceLimits, mistake, number, widthLimits } from '../core/limits.js';
import { fixed, plain, t } from '../model/i18n.js';
import { ask, askFreely } from '../model/commands.js';
import { connection } from '../model/store.js';
import { Covered, limitsText, NumberField, Panel, ProblemNote } from '../ui/parts.js';

function Facts({ facts }) {
  return html`<dl class="facts">${facts.filter(([,
      value]) => value !== null && value !== undefined && value !== '').map(([key, value]) => html`<div key=${key}>
        <dt>${t(key)}</dt><dd>${value}</dd></div>`)}</dl>`;
}

function About({ one }) {
  const info = one.info.value;
  if (!info) return null;
  return html`<${Panel} title=${t('device.title')} id="device-title"><${Facts} facts=${[
    ['device.model', info.device_type], ['device.serial', info.serial_number], ['device.firmware', info.firmware],
        ['device.hardware', info.hardware_revision], ['device.tag', info.device_tag], ['device.url', info.url],
    ['device.temperature', one.temperature.value === null ? null : `${fixed(one.temperature.value, 1)} °C`],
        ['device.capabilities', info.capabilities.join(', ')],
    ['device.if_gateway', t(info.stops_on_gateway_loss ? 'device.stops' : 'device.moves_on')],
  ]} /></${Panel}>`;
}

function Limits({ one }) {
  const info = one.info.value;
  const soft = one.softLimits.value;
  return html`<${Panel} title=${t('limits.title')} id="limits-title"><${Facts} facts=${[
    ['limits.stroke', limitsText(widthLimits(info, null), 'mm')],
    ['limits.soft', soft?.minus_mm == null ? t('limits.no_soft') : `${plain(soft.minus_mm)} – ${plain(soft.plus_mm)} mm`],
    ['limits.speed', info && `${plain(info.min_speed_mm_s)} – ${plain(info.max_speed_mm_s)} mm/s`],
        ['limits.acceleration', limitsText(accelerationLimits(info), 'mm/s²')],
    ['limits.force', limitsText(forceLimits(info, false), 'N')], ['limits.overdrive',
        info?.overdrive_force_n > info?.nominal_force_n ? `${plain(info.overdrive_force_n)} N` : null],
  ]} /></${Panel}>`;
}

/** One setting: what is typed, and what the device made of it. */
function Setting({ one, id, method, fields, limits, done }) {
  const wrong = fields.some(({ value, key }) => mistake(number(value.value), limits(key)));
  const send = async (event) => {
    event.preventDefault();
    const told = await ask(one, `${method}.set`, Object.fromEntries(fields.map(({ key, value }) => [key,
        number(value.value)])));
    if (!told) return;
    fields.forEach(({ key, value }) => { value.value = String(told[key]); });
    done();
  };
  return html`<form class="setting" onSubmit=${send}>
    <div class="fields">${fields.map(({ key, label, unit, value }) => html`<${NumberField} key=${key}
        id=${`${id}-${key}`} label=${label} unit=${unit} value=${value} limits=${limits(key)} isOptional=${true} />`)}
          </div>
    <div class="buttons"><button type="submit" disabled=${wrong}>${t('settings.set')}</button>
    ${method === 'settings.soft-limits' && html`<button type="button"
        disabled=${one.softLimits.value?.minus_mm == null} onClick=${async () => { if (await ask(one,
            'settings.soft-limits.clear')) done(); }}>${t('settings.clear')}</button>`}</div>
  </form>`;
}

function Settings({ one }) {
  const [acceleration, force, minus, plus, tag] = [useSignal(''), useSignal(''), useSignal(''), useSignal(''),
      useSignal('')];
  const said = useSignal('');
  const read = async () => {
    const [a, f, s, d] = await Promise.all(['acceleration', 'force-limit', 'soft-limits',
        'device-tag'].map((name) => askFreely(one, `settings.${name}`)));
    if (a) acceleration.value = String(a.acceleration_mm_s2);
    if (f) force.value = String(f.force_n);
    if (s?.minus_mm != null) [minus.value, plus.value] = [String(s.minus_mm), String(s.plus_mm)];
    if (d) tag.value = d.tag ?? '';
  };
  useEffect(() => { read(); }, [one, connection.value === 'live']);
  const done = () => { said.value = t('settings.done'); };
  const hasOverdrive = one.info.value?.capabilities.includes('overdrive');
  const isTag = /^[ -~]{0,64}$/.test(tag.value);
  return html`<${Panel} title=${t('settings.title')} id="settings-title" class="settings-panel">
    <p class="hint">${t('settings.hint')}</p>
    <${Setting} one=${one} id="acceleration" method="settings.acceleration"
        limits=${() => accelerationLimits(one.info.value)} done=${done} fields=${[{ key: 'acceleration_mm_s2',
            label: t('settings.acceleration'), unit: 'mm/s²', value: acceleration }]} />
    <${Setting} one=${one} id="force-limit" method="settings.force-limit" limits=${() => forceLimits(one.info.value,
        one.hasOverdrive.value)} done=${done} fields=${[{ key: 'force_n', label: t('settings.force_limit'), unit: 'N',
            value: force }]} />
    <${Setting} one=${one} id="soft-limits" method="settings.soft-limits" done=${done} limits=${(key) => {
      const all = widthLimits(one.info.value, null);
      return key === 'minus_mm' ? { ...all, max: Math.min(all.max, number(plus.value) || all.max) } : { ...all,
          min: Math.max(0, number(minus.value) || 0) };
    }} fields=${[{ key: 'minus_mm', label: t('settings.minus'), unit: 'mm', value: minus }, { key: 'plus_mm',
        label: t('settings.plus'), unit: 'mm', value: plus }]} />
    <form class="setting" onSubmit=${async (event) => { event.preventDefault(); if (await ask(one,
        'settings.device-tag.set', { tag: tag.value })) done(); }}>
      <div class=${`field ${isTag ? '' : 'wrong'}`}><label for="tag">${t('settings.tag')}</label><input id="tag"
          type="text" maxlength="64" aria-invalid=${isTag ? 'false' : 'true'} aria-describedby="tag-hint"
              value=${tag.value} onInput=${(event) => { tag.value = event.currentTarget.value; }} /><p class="hint"
                  id="tag-hint">${t('settings.tag_hint')}</p></div>
      <div class="buttons"><button type="submit" disabled=${!isTag}>${t('settings.set')}</button></div>
    </form>
    <div class="buttons">
      ${hasOverdrive && html`<button type="button" aria-pressed=${one.hasOverdrive.value ? 'true' : 'false'}
          onClick=${async () => { if (await ask(one, 'settings.overdrive.set',
              { enabled: !one.hasOverdrive.peek() })) done(); }}>${t('settings.overdrive')}: ${t(one.hasOverdrive.value ? 'settings.off' : 'settings.on')}
                </button>`}
      <button type="button" onClick=${async () => { if (await ask(one, 'tare')) done(); }}>${t('settings.tare')}
        </button>
    </div>
    <p class="small" role="status">${said.value}</p>
    <${ProblemNote} problem=${one.problem} />
  </${Panel}>`;
}

function Statistics({ one }) {
  const told = useSignal(null);
  const isSure = useSignal(false);
  useEffect(() => { askFreely(one, 'statistics').then((statistics) => { told.value = statistics; }); }, [one,
      one.runs.value, connection.value === 'live']);
  const figures = told.value;
  const good = figures && figures.total > 0 ? ((figures.total - figures.no_part - figures.lost_part) / figures.total) * 100 : null;
  const reset = async () => {
    if (!isSure.value) { isSure.value = true; return; }
    isSure.value = false;
    told.value = await ask(one, 'statistics.reset') ?? told.value;
  };
  return html`<${Panel} title=${t('statistics.title')} id="statistics-title"
      actions=${html`${isSure.value && html`<button type="button"
          onClick=${() => { isSure.value = false; }}>${t('cancel')}</button>`}<button type="button"
              onClick=${reset}>${t(isSure.value ? 'statistics.sure' : 'statistics.reset')}</button>`}>
    <${Facts} facts=${[['statistics.total', plain(figures?.total)], ['statistics.no_part', plain(figures?.no_part)],
        ['statistics.lost_part', plain(figures?.lost_part)], ['statistics.good', good === null ? '–' : `${fixed(good,
            1)} %`]]} />
  </${Panel}>`;
}

export function Device({ one }) {
  return html`<${Covered} one=${one}><div class="pair"><div class="column"><${About} one=${one} /><${Limits}
      one=${one} /><${Statistics} one=${one} /></div><${Settings} one=${one} /></div></${Covered}>`;
}
