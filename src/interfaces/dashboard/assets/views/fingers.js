// The fingers: type, flags, data, and power of generic fingers.

import { html, useEffect, useSignal } from '../lib.js';
import { fixed, t } from '../model/i18n.js';
import { ask } from '../model/commands.js';
import { get } from '../net/rest.js';
import { isLive } from '../model/state.js';
import { Facts } from '../ui/facts.js';
import { fromHex, toHex } from '../core/frame.js';
import { Panel, Shape } from '../ui/parts.js';

const ASKED_EVERY_MS = 1000;
const FINGERS = [1, 2];
/** A force measuring finger sends its force in N as a float. */
const FORCE_FINGER = 'WSG-FMF';
const SHOWN_BYTES = 16;

const isFault = (flag) => flag.endsWith('_FAULT');

function dataText({ type, data }) {
  if (!data) return null;
  const bytes = fromHex(data);
  if (type === FORCE_FINGER && bytes.length === 4)
    return `${fixed(new DataView(bytes.buffer).getFloat32(0, true), 1)} N`;
  return `${toHex(bytes.slice(0, SHOWN_BYTES), ' ')}${bytes.length > SHOWN_BYTES ? ' …' : ''}`;
}

async function learn(gripper, finger) {
  const path = `grippers/${gripper.name}/fingers/${finger}`;
  const info = await get(path);
  const { data } = info.data_bytes > 0 ? await get(`${path}/data`).catch(() => ({})) : {};
  return { ...info, data };
}

function Finger({ gripper, finger }) {
  const known = useSignal(null);
  const isOn = known.value?.flags.includes('POWER_ON');
  useEffect(() => {
    let isWanted = true;
    const look = async () => {
      if (!isLive.peek() || document.hidden) return;
      // Without a link, the gateway would refuse the read.
      const answer = gripper.isThere.peek() ? await learn(gripper, finger).catch(() => null) : null;
      if (isWanted) known.value = answer;
    };
    look();
    const timer = setInterval(look, ASKED_EVERY_MS);
    return () => {
      isWanted = false;
      clearInterval(timer);
    };
  }, [gripper, finger]);
  const flags = known.value?.flags ?? [];
  return html`<div class="column" data-finger=${finger}><h3>${t('finger.number', { finger })}</h3>
    <${Facts} facts=${[
      ['finger.type', known.value?.type ?? '–'],
      [
        'finger.flags',
        html`${flags.map(
          (flag) =>
            html`<span key=${flag} class=${isFault(flag) ? 'finger-fault tone-critical' : ''}>${
              isFault(flag) && html`<${Shape} name="critical" />`
            } ${t(`finger.${flag}`)} </span>`,
        )}`,
      ],
      ['finger.data', known.value && dataText(known.value)],
    ]} />
    ${
      known.value?.type === 'generic' &&
      html`<button type="button" aria-label=${`${t(isOn ? 'finger.off' : 'finger.on')}: ${t('finger.number', { finger })}`}
        onClick=${() => ask(gripper, 'fingers.power', { finger, enabled: !isOn })}>${t(isOn ? 'finger.off' : 'finger.on')}</button>`
    }</div>`;
}

export function Fingers({ gripper }) {
  if (!gripper.info.value?.capabilities.includes('fingers')) return null;
  return html`<${Panel} title=${t('finger.title')} id="fingers-title"><div class="pair">${FINGERS.map(
    (finger) => html`<${Finger} key=${`${gripper.name}/${finger}`} gripper=${gripper} finger=${finger} />`,
  )}</div></${Panel}>`;
}
