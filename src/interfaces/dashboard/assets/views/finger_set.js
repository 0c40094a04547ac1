// The mounted fingers, their use, and the limits after which they need maintenance.

import { html, useEffect, useSignal } from '../lib.js';
import { asTyped, mistake, typedFrom } from '../core/limits.js';
import { askFreely } from '../model/commands.js';
import { fixed, fullDate, plain, t } from '../model/i18n.js';
import { mayOperate } from '../model/me.js';
import { read } from '../model/reads.js';
import { isLive } from '../model/state.js';
import { ConfirmButton } from '../ui/confirm.js';
import { Panel, Shape, useNewest, within } from '../ui/parts.js';
import { NumberField } from '../ui/fields.js';
import { Facts } from '../ui/facts.js';

const MAX_ID_BYTES = 48;
/** A grip is counted a second after its end. */
const COUNTED_WITHIN_MS = 1500;
const CYCLES = { min: 1, max: 1_000_000_000, whose: 'device' };
const TRAVEL_M = { min: 0.01, max: 1_000_000_000, whose: 'device' };

/** Text of a count with its unit, and with its limit if there is one. */
const used = (text, limit, unit) => `${text}${limit === null ? '' : ` / ${plain(limit)}`}${unit}`;

function Form({ gripper, set, asking }) {
  const id = useSignal(set.id ?? '');
  const cycles = useSignal(asTyped(set.maintenance_cycles));
  const travel = useSignal(asTyped(set.maintenance_travel_m));
  const given = () => ({
    maintenance_cycles: typedFrom(set.maintenance_cycles, cycles.value),
    maintenance_travel_m: typedFrom(set.maintenance_travel_m, travel.value),
  });
  const isWrong =
    id.value.trim() === '' ||
    [
      [given().maintenance_cycles, CYCLES],
      [given().maintenance_travel_m, TRAVEL_M],
    ].some(([value, limits]) => value !== undefined && mistake(value, limits));
  const send = async (reset) => {
    const take = asking();
    const answer = await askFreely(gripper, 'finger-set.set', { id: id.peek().trim(), reset, ...given() });
    if (answer) take(answer);
  };
  const save = (event) => {
    event.preventDefault();
    send(false);
  };
  return html`<form onSubmit=${save} aria-labelledby="finger-set-title"><div class="fields">
      <div class="field"><label for="finger-set-id">${t('set.id')}</label><div class="input"><input id="finger-set-id"
          type="text" autocomplete="off" value=${id.value} onInput=${within(MAX_ID_BYTES, (text) => {
            id.value = text;
          })} /></div></div>
      <${NumberField} id="finger-set-cycles" label=${t('set.maintenance_cycles')} unit="" value=${cycles} limits=${CYCLES}
          isOptional=${true} whenEmpty=${t('set.no_limit')} />
      <${NumberField} id="finger-set-travel" label=${t('set.maintenance_travel')} unit="m" value=${travel}
          limits=${TRAVEL_M} isOptional=${true} whenEmpty=${t('set.no_limit')} />
    </div><div class="buttons"><button type="submit" id="finger-set-save" disabled=${isWrong}>${t('set.save')}</button>${
      set.id !== null &&
      html`<${ConfirmButton} id="finger-set-reset" label=${t('set.reset')} sureLabel=${t('set.reset_sure')}
          disabled=${isWrong} act=${() => send(true)} />`
    }</div><p class="hint">${t('set.hint')}</p></form>`;
}

export function FingerSet({ gripper }) {
  const [known, asking] = useNewest();
  useEffect(() => {
    const look = () => read('finger-set', gripper).then(asking(), () => {});
    look();
    const timer = setTimeout(look, COUNTED_WITHIN_MS);
    return () => clearTimeout(timer);
  }, [gripper, gripper.changes.value, isLive.value]);
  const set = known.value;
  if (!set) return null;
  const facts = [
    ['set.id', set.id ?? t('set.none')],
    ['set.mounted_at', set.mounted_at && fullDate(set.mounted_at)],
    ['set.cycles', set.cycles !== null && used(plain(set.cycles), set.maintenance_cycles, '')],
    ['set.travel', set.travel_m !== null && used(fixed(set.travel_m, 1), set.maintenance_travel_m, ' m')],
  ];
  // When somebody else changes the set, the form shows the new values.
  const identity = [set.id, set.maintenance_cycles, set.maintenance_travel_m].join();
  return html`<${Panel} title=${t('set.title')} id="finger-set-title">
    ${set.maintenance_due && html`<p class="tone-low"><${Shape} name="low" /> ${t('alarm.maintenance_due')}</p>`}
    <${Facts} facts=${facts.filter(([, value]) => value !== false)} />
    ${mayOperate(gripper.name) && html`<${Form} key=${`${gripper.name}/${identity}`} gripper=${gripper} set=${set} asking=${asking} />`}
  </${Panel}>`;
}
