// Recipes as tiles: one tap grips. The values by hand are below them.

import { html, useEffect, useSignal } from '../lib.js';
import { number } from '../core/limits.js';
import { move } from '../model/commands.js';
import { canGrip, handOf, valuesOfRecipe } from '../model/hand.js';
import { fixed, plain, t } from '../model/i18n.js';
import { mayOperateAll } from '../model/me.js';
import { loadOutcomes, outcomeOf } from '../model/outcomes.js';
import { loadRecipes, recipes } from '../model/recipes.js';
import { whyNoGrip } from '../model/steps.js';
import { isLive } from '../model/state.js';
import { Covered, Name, Panel, Shape } from '../ui/parts.js';
import { isGood } from '../ui/result.js';
import { ByHand } from './hand.js';
import { RecipeEditor } from './recipe_editor.js';

/** Number of recipes from which on they can be searched. */
const SEARCHED_FROM = 9;

const measure = (value, unit) => (value == null ? null : `${plain(value)} ${unit}`);

/** Text of a tile below its main values. */
function moreText({ accept_min_mm: min, accept_max_mm: max, description }) {
  const accepted = (min ?? max) == null ? null : `${plain(min)} – ${plain(max)} mm`;
  return [accepted, description].filter(Boolean).join(' · ');
}

function LastOutcome({ gripper, recipe }) {
  const last = outcomeOf(gripper, recipe.number);
  if (last === null) return html`<span class="tile-last muted">${t('recipe.not_yet')}</span>`;
  const width = last.width_mm === null ? '' : ` ${fixed(last.width_mm, 2)} mm`;
  return html`<span class="tile-last"><${Shape} name=${isGood(last.outcome) ? 'check' : 'high'} /> ${t(`outcome.${last.outcome}`)}${width}</span>`;
}

function Tile({ gripper, recipe, edit }) {
  const { number: recipeNumber, part_id: part, version } = recipe;
  const hand = handOf(gripper);
  const values = valuesOfRecipe(recipe, gripper);
  const isChosen = hand.chosen.value === part;
  const more = moreText(values);
  return html`<li class=${`recipe ${isChosen ? 'chosen' : ''}`} data-recipe=${recipeNumber}>
    <button type="button" class="tile-grip" data-act="command.grip" disabled=${whyNoGrip(gripper) !== null || !canGrip(values)} onClick=${() => {
      hand.chosen.value = part;
      move(gripper, 'grip', { recipe: recipeNumber, recipe_version: version });
    }}><span class="tile-name"><span class="visually-hidden">${t('command.grip')} </span><span class="muted">${recipeNumber}</span> <${Name} text=${part} /></span>
      <span class="tile-values">${[measure(values.width_mm, 'mm'), measure(values.force_n, 'N')].filter(Boolean).join(' · ') || '–'}</span>
      <${LastOutcome} gripper=${gripper} recipe=${recipe} />${more && html`<span class="tile-more muted">${more}</span>`}</button>
    ${
      mayOperateAll() &&
      html`<button type="button" class="quiet tile-edit" data-act="recipe.edit" aria-label=${`${t('recipe.edit')}: ${part}`}
          title=${t('recipe.edit')} onClick=${() => edit(recipe)}><${Shape} name="pen" /></button>`
    }
  </li>`;
}

export function Recipes({ gripper }) {
  const search = useSignal('');
  // The form: `{recipe, draft}`, with null for a new recipe; null without a form.
  const edited = useSignal(null);
  const isKnown = recipes.value !== null;
  useEffect(() => {
    if (isLive.value) loadRecipes();
  }, [isLive.value]);
  useEffect(() => {
    if (isKnown) loadOutcomes(gripper);
  }, [gripper, isKnown]);
  const all = recipes.value ?? [];
  const wanted = search.value.trim().toLowerCase();
  const isWanted = ({ number: recipeNumber, part_id: part, description }) =>
    `${recipeNumber} ${part} ${description}`.toLowerCase().includes(wanted);
  const shown = all.length >= SEARCHED_FROM ? all.filter(isWanted) : all;
  const draftByHand = () => {
    const hand = handOf(gripper);
    const known = (text) => (Number.isNaN(number(text)) ? undefined : number(text));
    edited.value = {
      recipe: null,
      draft: {
        part_id: hand.part.peek(),
        width_mm: known(hand.width.peek()),
        speed_mm_s: known(hand.speed.peek()),
        force_n: known(hand.force.peek()),
        release_width_mm: known(hand.open.value),
      },
    };
  };
  const actions =
    mayOperateAll() &&
    edited.value === null &&
    html`<button type="button" id="recipe-new" class="quiet" onClick=${() => {
      edited.value = { recipe: null };
    }}>${t('recipe.new')}</button>`;
  if (edited.value !== null) {
    const { recipe, draft } = edited.value;
    return html`<${Panel} title=${t(recipe ? 'recipe.change' : 'recipe.new')} id="recipes-title" class="recipes-panel">
      <${RecipeEditor} key=${recipe?.part_id ?? ''} recipe=${recipe} draft=${draft} close=${() => {
        edited.value = null;
        document.getElementById('recipes-title')?.focus();
      }} />
    </${Panel}>`;
  }
  return html`<${Panel} title=${t('recipe.title')} id="recipes-title" class="recipes-panel" actions=${actions}><${Covered} gripper=${gripper}>
    ${
      all.length >= SEARCHED_FROM &&
      html`<div class="field"><label class="visually-hidden" for="recipe-search">${t('recipe.search')}</label><input id="recipe-search"
          type="search" placeholder=${t('recipe.search')} value=${search.value} onInput=${(event) => {
            search.value = event.currentTarget.value;
          }} /></div>`
    }
    ${
      all.length === 0
        ? html`<p class="muted small recipes-none">${isKnown && t('recipe.none')}</p>`
        : html`<ul class="recipes" tabindex="0" aria-labelledby="recipes-title">${shown.map(
            (recipe) => html`<${Tile} key=${recipe.part_id} gripper=${gripper} recipe=${recipe}
                edit=${(chosen) => {
                  edited.value = { recipe: chosen };
                }} />`,
          )}</ul>`
    }
    <${ByHand} gripper=${gripper} onSave=${mayOperateAll() ? draftByHand : null} />
  </${Covered}></${Panel}>`;
}
