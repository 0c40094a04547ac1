// The buttons that move the fingers, always at the same places: Stop, Grip, Release, Home and jogging.

import { computed, html, useMemo } from '../lib.js';
import { forceLimits, mistake, number, speedLimits, widthLimits } from '../core/limits.js';
import { fixed, plain, t } from '../model/i18n.js';
import { askFreely, move } from '../model/commands.js';
import { canGrip, canRelease, chosenRecipe, defaultOpen, handOf, valuesOfRecipe } from '../model/hand.js';
import { isLive } from '../model/state.js';
import { stepOf, whyNoGrip, whyNot } from '../model/steps.js';
import { Covered, Name, onPress, Panel, Shape } from '../ui/parts.js';
import { hasFailed } from '../ui/result.js';
import { stopOne } from '../ui/stop.js';
import { JogPanel } from './jog.js';

/** Progress or outcome of the newest command. */
function LastCommand({ gripper }) {
  const command = gripper.command.value;
  if (!command) return html`<p class="last muted" role="status">${t('last.none')}</p>`;
  const shape = hasFailed(command) ? 'high' : command.outcome ? 'check' : 'moving';
  const duration = command.duration_ms == null ? '' : `${fixed(command.duration_ms / 1000, 2)} s`;
  return html`<p class="last" role="status" data-outcome=${command.outcome ?? 'running'}><${Shape} name=${shape} />
    <strong>${t(`command.${command.kind}`)}
      </strong> ${command.outcome ? t(`outcome.${command.outcome}`) : t('outcome.running')}
    <span class="muted">${command.phase === 'done' || command.outcome ? duration : ''}</span></p>`;
}

const valueText = (value, unit) =>
  value === null || value === undefined || Number.isNaN(value) ? null : `${plain(value)} ${unit}`;

/** Parameters of Grip, a short text, and whether a value is wrong. */
function gripOf(gripper, limits) {
  const hand = handOf(gripper);
  const recipe = chosenRecipe(gripper);
  if (recipe !== null) {
    const values = valuesOfRecipe(recipe, gripper);
    return {
      params: { recipe: recipe.number, recipe_version: recipe.version },
      name: recipe.part_id,
      text: [valueText(values.width_mm, 'mm'), valueText(values.force_n, 'N')].filter(Boolean).join(' · '),
      isWrong: !canGrip(values),
    };
  }
  const width_mm = number(hand.width.value);
  const speed_mm_s = number(hand.speed.value);
  const hasForce = hand.force.value.trim() !== '';
  const force_n = number(hand.force.value);
  return {
    params: {
      width_mm,
      speed_mm_s,
      ...(hasForce ? { force_n } : {}),
      ...(hand.part.value === '' ? {} : { part_id: hand.part.value }),
    },
    name: null,
    text: [valueText(width_mm, 'mm'), hasForce ? valueText(force_n, 'N') : null].filter(Boolean).join(' · '),
    isWrong: Boolean(
      mistake(width_mm, limits.width.value) ||
        mistake(speed_mm_s, limits.speed.value) ||
        (hasForce && mistake(force_n, limits.force.value)),
    ),
  };
}

/** The same for Release. */
function releaseOf(gripper, limits) {
  const hand = handOf(gripper);
  const recipe = chosenRecipe(gripper);
  const values = recipe && valuesOfRecipe(recipe, gripper);
  if (values && canRelease(values)) {
    return {
      params: { recipe: recipe.number, recipe_version: recipe.version },
      text: valueText(values.release_width_mm, 'mm'),
      isWrong: false,
    };
  }
  const width_mm = hand.open.value.trim() === '' ? defaultOpen(gripper, hand.width) : number(hand.open.value);
  const speed_mm_s = number(hand.speed.value);
  return {
    params: { width_mm, speed_mm_s },
    text: valueText(width_mm, 'mm'),
    isWrong: Boolean(mistake(width_mm, limits.width.value) || mistake(speed_mm_s, limits.speed.value)),
  };
}

function Controls({ gripper }) {
  const hand = handOf(gripper);
  const limits = useMemo(
    () => ({
      width: computed(() => widthLimits(gripper.info.value, gripper.softLimits.value)),
      speed: computed(() => speedLimits(gripper.info.value)),
      force: computed(() => forceLimits(gripper.info.value, gripper.hasOverdrive.value)),
    }),
    [gripper],
  );
  const reason = whyNot(gripper);
  const noGrip = whyNoGrip(gripper);
  const noHome = whyNot(gripper, false);
  const step = stepOf(gripper);
  const isPrimary = (name) => (step === name ? 'primary' : '');
  const grip = gripOf(gripper, limits);
  const release = releaseOf(gripper, limits);
  const shown = noGrip ?? (grip.isWrong || release.isWrong ? 'why.limits' : null);
  return html`<div class="controls">
    <div class="pair-of-two">
      <button type="button" id="grip" class=${`act ${isPrimary('grip')}`} disabled=${noGrip !== null || grip.isWrong}
          onClick=${() => move(gripper, 'grip', grip.params)}><span class="act-word">${t('command.grip')}</span><span
          class="act-what">${grip.name !== null && html`<${Name} text=${grip.name} /> `}${grip.text || '–'}</span></button>
      <button type="button" id="release" class=${`act ${isPrimary('release')}`} disabled=${reason !== null || release.isWrong}
          onClick=${() => move(gripper, 'release', release.params)}><span class="act-word">${t('command.release')}</span><span
          class="act-what">→ ${release.text ?? '–'}</span></button>
    </div>
    <p class="why small" role="status">${shown ? t(shown) : ''}</p>
    <button type="button" id="home" class=${isPrimary('home')} disabled=${noHome !== null} onClick=${() =>
      move(gripper, 'home', { direction: hand.direction.value })}>${t('command.home')}</button>
    <${JogPanel} gripper=${gripper} speed=${hand.speed} force=${hand.force} limits=${limits} reason=${reason} />
  </div>`;
}

export function Motion({ gripper }) {
  const isLatched = gripper.latchId.value !== null;
  return html`<${Panel} title=${t('motion.title')} id="motion-title" class="motion-panel">
    <div class="pair-of-two stops"><button type="button" id="stop-soft" disabled=${!isLive.value} onClick=${() =>
      askFreely(gripper, 'stop')}>${t('command.stop')}</button>
    <button type="button" id="stop-one" class="at-once" ...${onPress(() => stopOne(gripper))}><span>FAST STOP <${Name}
        text=${gripper.name} /></span></button></div>
    <${Covered} gripper=${gripper}>
      ${!isLatched && html`<${Controls} gripper=${gripper} />`}
      <${LastCommand} gripper=${gripper} />
    </${Covered}>
  </${Panel}>`;
}
