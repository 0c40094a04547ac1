// The form of a recipe, which all browsers and programs share.

import { html, useSignal } from '../lib.js';
import { asTyped, mistake, number, typedFrom } from '../core/limits.js';
import { plain, t } from '../model/i18n.js';
import { loadRecipes, recipes } from '../model/recipes.js';
import { rpc } from '../model/wire.js';
import { ConfirmButton } from '../ui/confirm.js';
import { MAX_PART_BYTES, ProblemNote, within } from '../ui/parts.js';
import { NumberField } from '../ui/fields.js';

const MAX_NUMBER = 255;
const MAX_DESCRIPTION_BYTES = 200;

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

/** Form for a recipe. `recipe` is the one to change, or null for a new one, which begins with the values `draft`. */
export function RecipeEditor({ recipe, draft = {}, close }) {
  const problem = useSignal(null);
  const part = useSignal(recipe?.part_id ?? draft.part_id ?? '');
  const recipeNumber = useSignal(String(recipe?.number ?? freeNumber()));
  const description = useSignal(recipe?.description ?? '');
  const signals = Object.fromEntries(VALUES.map(([field]) => [field, useSignal(asTyped((recipe ?? draft)[field]))]));
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
        html`<${ConfirmButton} id="recipe-remove" label=${t('recipe.remove')} sureLabel=${t('recipe.remove_sure')}
            act=${() => send('recipe.remove', {})} />`
      }
      <${Teach} part=${part.value} signals=${signals} problem=${problem} />
    </div>
    ${others.length > 0 && html`<p class="hint">${t('recipe.others', { grippers: others.join(', ') })}</p>`}
    <${ProblemNote} problem=${problem} />
  </form>`;
}
