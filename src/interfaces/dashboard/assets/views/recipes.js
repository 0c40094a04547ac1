// Recipes, which all browsers and programs share: one tap grips by recipe.

import { html, useEffect, useSignal } from '../lib.js';
import { asTyped, mistake, number, typedFrom } from '../core/limits.js';
import { move } from '../model/commands.js';
import { plain, t } from '../model/i18n.js';
import { mayOperateAll } from '../model/me.js';
import { loadRecipes, recipes } from '../model/recipes.js';
import { isLive, rpc } from '../model/store.js';
import { MAX_PART_BYTES, Panel, ProblemNote, within } from '../ui/parts.js';
import { NumberField } from './fields.js';
import { whyNot } from './motion.js';

const MAX_NUMBER = 255;
const MAX_DESCRIPTION_BYTES = 200;
/** Number of recipes from which on they can be searched. */
const SEARCHED_FROM = 9;

/** Bounds that no gripper exceeds, as for the gateway. Each gripper has limits of its own. */
const WIDTHS = { min: 0, max: 1000, whose: 'device' };
const SPEEDS = { min: 0, max: 10_000, whose: 'device' };
const FORCES = { min: 0, max: 10_000, whose: 'device' };

/** Values of a recipe: field, unit and bounds. */
const VALUES = [
  ['width_mm', 'mm', WIDTHS],
  ['speed_mm_s', 'mm/s', SPEEDS],
  ['force_n', 'N', FORCES],
  ['accept_min_mm', 'mm', WIDTHS],
  ['accept_max_mm', 'mm', WIDTHS],
  ['release_width_mm', 'mm', WIDTHS],
  ['release_speed_mm_s', 'mm/s', SPEEDS],
];

/** The lowest number without a recipe; 0 if there is none. */
function freeNumber() {
  const taken = new Set(recipes.peek()?.map((recipe) => recipe.number));
  for (let free = 1; free <= MAX_NUMBER; free += 1) if (!taken.has(free)) return free;
  return 0;
}

/** Proposes limits from the part's last grips. */
function Teach({ part, signals, problem }) {
  const taught = useSignal(null);
  const propose = async () => {
    problem.value = null;
    try {
      taught.value = await rpc.call('recipe.teach', { part_id: part });
      signals.accept_min_mm.value = asTyped(taught.value.accept_min_mm);
      signals.accept_max_mm.value = asTyped(taught.value.accept_max_mm);
    } catch (refusal) {
      problem.value = refusal;
    }
  };
  const { count, mean_mm: mean, standard_deviation_mm: spread } = taught.value ?? {};
  return html`<button type="button" id="recipe-teach" disabled=${part === ''} onClick=${propose}>${t('recipe.teach')}
    </button><p class="hint" role="status">${
      taught.value && t('recipe.taught', { count, mean: plain(mean), spread: plain(spread) })
    }</p>`;
}

/** Form for a recipe. `recipe` is the one to change, or null for a new one. */
function Editor({ recipe, close }) {
  const problem = useSignal(null);
  const isSure = useSignal(false);
  const part = useSignal(recipe?.part_id ?? '');
  const recipeNumber = useSignal(String(recipe?.number ?? freeNumber()));
  const description = useSignal(recipe?.description ?? '');
  const signals = Object.fromEntries(VALUES.map(([field]) => [field, useSignal(asTyped(recipe?.[field]))]));
  const send = async (method, params) => {
    problem.value = null;
    try {
      await rpc.call(method, { part_id: part.peek(), if_version: recipe?.version ?? 0, ...params });
      await loadRecipes();
      close();
    } catch (refusal) {
      problem.value = refusal;
    }
  };
  const given = VALUES.map(([field, , limits]) => [field, typedFrom(recipe?.[field], signals[field].value), limits]);
  const isWrong =
    part.value === '' ||
    mistake(number(recipeNumber.value), { min: 1, max: MAX_NUMBER }) !== null ||
    given.some(([, value, limits]) => value !== undefined && mistake(value, limits));
  const others = Object.keys(recipe?.grippers ?? {});
  const save = (event) => {
    event.preventDefault();
    const values = given.filter(([, value]) => value !== undefined).map(([field, value]) => [field, value]);
    send('recipe.set', {
      number: number(recipeNumber.peek()),
      description: description.peek(),
      grippers: recipe?.grippers ?? {},
      ...Object.fromEntries(values),
    });
  };
  return html`<form class="recipe-form" onSubmit=${save} aria-label=${t(recipe ? 'recipe.change' : 'recipe.new')}>
    <div class="fields">
      <div class="field"><label for="recipe-part">${t('field.part')}</label><div class="input"><input id="recipe-part"
          type="text" autocomplete="off" required readonly=${recipe !== null} value=${part.value}
          onInput=${within(MAX_PART_BYTES, (text) => {
            part.value = text;
          })} /></div></div>
      <${NumberField} id="recipe-number" label=${t('recipe.number')} unit="" value=${recipeNumber}
          limits=${{ min: 1, max: MAX_NUMBER, whose: 'device' }} />
      ${VALUES.map(
        ([field, unit, limits]) => html`<${NumberField} key=${field} id=${`recipe-${field}`}
          label=${t(`recipe.${field}`)} unit=${unit} value=${signals[field]} limits=${limits} isOptional=${true}
          whenEmpty=${t(`recipe.without.${field}`)} />`,
      )}
      <div class="field"><label for="recipe-description">${t('recipe.description')}</label><div class="input"><input
          id="recipe-description" type="text" autocomplete="off" value=${description.value}
          onInput=${within(MAX_DESCRIPTION_BYTES, (text) => {
            description.value = text;
          })} /></div></div>
    </div>
    <div class="buttons">
      <button type="submit" id="recipe-save" class="primary" disabled=${isWrong}>${t('recipe.save')}</button>
      <button type="button" onClick=${close}>${t('cancel')}</button>
      ${
        recipe &&
        html`<button type="button" id="recipe-remove" onClick=${() => {
          if (isSure.peek()) send('recipe.remove', {});
          else isSure.value = true;
        }}>${t(isSure.value ? 'recipe.remove_sure' : 'recipe.remove')}</button>`
      }
      <${Teach} part=${part.value} signals=${signals} problem=${problem} />
    </div>
    ${others.length > 0 && html`<p class="hint">${t('recipe.others', { grippers: others.join(', ') })}</p>`}
    <${ProblemNote} problem=${problem} />
  </form>`;
}

/** The values of a recipe for a gripper, as a short text. */
function summary(recipe, gripper) {
  const values = { ...recipe, ...recipe.grippers[gripper] };
  const of = (value, unit) => value !== undefined && `${plain(value)} ${unit}`;
  const { accept_min_mm: min, accept_max_mm: max } = values;
  const accepted = (min ?? max) !== undefined && `${plain(min)} – ${plain(max)} mm`;
  const release = values.release_width_mm !== undefined && `→ ${plain(values.release_width_mm)} mm`;
  const shown = [of(values.width_mm, 'mm'), of(values.speed_mm_s, 'mm/s'), of(values.force_n, 'N'), accepted, release];
  return shown.filter(Boolean).join(' · ');
}

function Row({ one, recipe, edit }) {
  const reason = whyNot(one);
  const { number: recipeNumber, part_id: part, description, version } = recipe;
  const button = (key, act, isOff = false) => html`<button type="button" data-act=${key} disabled=${isOff}
      aria-label=${`${t(key)}: ${part}`} onClick=${act}>${t(key)}</button>`;
  const isMissing = (field) => (recipe.grippers[one.name]?.[field] ?? recipe[field]) === undefined;
  return html`<li class="recipe" data-recipe=${recipeNumber}>
    <span class="recipe-name"><span class="muted">${recipeNumber}</span> <strong>${part}</strong>
      <span class="small muted">${summary(recipe, one.name)}${description && ` · ${description}`}</span></span>
    <span class="recipe-buttons">${button(
      'command.grip',
      () => move(one, 'grip', { recipe: recipeNumber, recipe_version: version }),
      reason || isMissing('width_mm') || isMissing('speed_mm_s'),
    )}${button(
      'command.release',
      () => move(one, 'release', { recipe: recipeNumber, recipe_version: version }),
      reason || isMissing('release_width_mm') || (isMissing('release_speed_mm_s') && isMissing('speed_mm_s')),
    )}${mayOperateAll() && button('recipe.edit', () => edit(recipe))}</span>
  </li>`;
}

export function Recipes({ one }) {
  const search = useSignal('');
  // The recipe in the form, null for a new one, or undefined without a form.
  const edited = useSignal(undefined);
  useEffect(() => {
    if (isLive.value) loadRecipes();
  }, [isLive.value]);
  const all = recipes.value ?? [];
  const wanted = search.value.trim().toLowerCase();
  const isWanted = ({ number: recipeNumber, part_id: part, description }) =>
    `${recipeNumber} ${part} ${description}`.toLowerCase().includes(wanted);
  const shown = all.length >= SEARCHED_FROM ? all.filter(isWanted) : all;
  const actions =
    mayOperateAll() &&
    html`<button type="button" id="recipe-new" onClick=${() => {
      edited.value = null;
    }}>${t('recipe.new')}</button>`;
  return html`<${Panel} title=${t('recipe.title')} id="recipes-title" class="recipes-panel" actions=${actions}>
    ${
      edited.value !== undefined &&
      html`<${Editor} key=${edited.value?.version ?? ''} recipe=${edited.value} close=${() => {
        edited.value = undefined;
        document.getElementById('recipes-title')?.focus();
      }} />`
    }
    ${
      all.length >= SEARCHED_FROM &&
      html`<div class="field"><label for="recipe-search">${t('recipe.search')}</label><input id="recipe-search"
          type="search" value=${search.value} onInput=${(event) => {
            search.value = event.currentTarget.value;
          }} /></div>`
    }
    ${
      all.length === 0
        ? html`<p class="muted small">${recipes.value !== null && t('recipe.none')}</p>`
        : html`<ul class="recipes" tabindex="0" aria-labelledby="recipes-title">${shown.map(
            (recipe) => html`<${Row} key=${recipe.part_id} one=${one} recipe=${recipe}
          edit=${(chosen) => {
            edited.value = chosen;
          }} />`,
          )}</ul>`
    }
  </${Panel}>`;
}
