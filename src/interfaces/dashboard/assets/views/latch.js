// A latched FAST STOP replaces the recipes and the controls: origin, cause and time, what to check, and a button to acknowledge.

import { html, useEffect, useSignal } from '../lib.js';
import { span, t, time } from '../model/i18n.js';
import { SEEN_AFTER_MS, shortId } from '../core/ids.js';
import { nameIn, person } from '../core/people.js';
import { acknowledge } from '../model/commands.js';
import { myName } from '../model/name.js';
import { now } from '../model/state.js';
import { Covered, Shape } from '../ui/parts.js';

const CHECKS = {
  requested: ['hands', 'area', 'reason'],
  client_lost: ['hands', 'client', 'part'],
  unannounced_disconnect: ['hands', 'gateway', 'part'],
  temperature_fault: ['cool', 'load'],
  power_fault: ['power', 'cable'],
  current_fault: ['blocked', 'wait'],
  finger_fault: ['finger', 'cable'],
  soft_limit: ['limits', 'hands'],
  unknown: ['hands', 'area', 'device'],
};

function whoText(by, reason) {
  if (by === 'device') return t('latch.device');
  const who = person(by, nameIn(reason));
  return nameIn(reason) === myName.value ? t('latch.you', { who }) : who;
}

export function Latch({ gripper }) {
  const state = gripper.state.value;
  const {
    fast_stop_id: id,
    fast_stop_by: by,
    fast_stop_cause: cause,
    fast_stop_reason: reason,
    fast_stop_at: at,
    fast_stop_confirmed: isConfirmed,
  } = state;
  const seen = useSignal(null);
  useEffect(() => {
    const timer = setTimeout(() => {
      seen.value = id;
    }, SEEN_AFTER_MS);
    return () => clearTimeout(timer);
  }, [id]);
  return html`<section class="panel latch" aria-labelledby="latch-title"><${Covered} gripper=${gripper}>
    <h2 id="latch-title" tabindex="-1"><${Shape} name="critical" /> ${t('latch.title')} <code>…${shortId(id)}</code></h2>
    <dl class="facts">
      <div><dt>${t('latch.by')}</dt><dd id="latch-by">${whoText(by, reason)}</dd></div>
      <div><dt>${t('latch.cause')}</dt><dd>${t(`cause.${cause}`)}${reason && html`<br /><q>${reason}</q>`}</dd></div>
      <div><dt>${t('latch.at')}</dt><dd>${time(at)} (${t('ago', { span: span(now.value - Date.parse(at)) })})</dd></div>
      <div><dt>${t('latch.device_says')}</dt><dd>${t(isConfirmed ? 'latch.confirmed' : 'latch.unconfirmed')}</dd></div>
    </dl>
    <h3>${t('latch.check')}</h3>
    <ul>${(CHECKS[cause] ?? CHECKS.unknown).map((check) => html`<li key=${check}>${t(`check.${check}`)}</li>`)}</ul>
    <button type="button" id="acknowledge" class="primary" disabled=${seen.value !== id || !isConfirmed}
        onClick=${() => acknowledge(gripper, id)}>${t('latch.acknowledge', { id: `…${shortId(id)}` })}</button>
    <p class="hint">${t('latch.hint')}</p>
  </${Covered}></section>`;
}
