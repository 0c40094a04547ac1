// The page's texts, in the user's language.

import { computed, effect, signal } from '../lib.js';
import { gatewayNow } from '../core/clock.js';
import { fill, placeholders } from '../core/words.js';
import { kept } from './prefs.js';
import { de } from '../locales/de.js';
import { en } from '../locales/en.js';

const DICTIONARIES = { de, en };

export const LANGUAGES = Object.keys(DICTIONARIES);

const preferred = navigator.languages.map((tag) => tag.slice(0, 2)).find((tag) => tag in DICTIONARIES) ?? 'en';

export const language = kept('language', preferred);

/** Texts of what is loaded after the first screen, by language. */
const moreTexts = signal({});

export function addTexts(texts) {
  moreTexts.value = texts;
}

const words = computed(() => ({ ...(DICTIONARIES[language.value] ?? en), ...moreTexts.value[language.value] }));

effect(() => {
  document.documentElement.lang = language.value;
});

/** Lets a name be broken after its separators: it has no spaces. */
export const breakable = (name) => name.replaceAll('_', '_\u200b');

export function t(key, parameters = {}) {
  const template = words.value[key];
  if (template === undefined) return key;
  const given = Object.entries(parameters).map(([name, value]) => [
    name,
    typeof value === 'string' ? breakable(value) : value,
  ]);
  return fill(template, Object.fromEntries(given));
}

const formats = computed(() => {
  const tag = language.value;
  // Grouped digits would look like decimals in another language, and number fields reject them.
  const digits = (count) =>
    new Intl.NumberFormat(tag, { useGrouping: false, minimumFractionDigits: count, maximumFractionDigits: count });
  return {
    digits: [0, 1, 2, 3].map(digits),
    any: new Intl.NumberFormat(tag, { useGrouping: false, maximumFractionDigits: 2 }),
    time: new Intl.DateTimeFormat(tag, { hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false }),
    full: new Intl.DateTimeFormat(tag, { dateStyle: 'long', timeStyle: 'short' }),
    date: new Intl.DateTimeFormat(tag, {
      day: '2-digit',
      month: '2-digit',
      hour: '2-digit',
      minute: '2-digit',
      second: '2-digit',
      hour12: false,
    }),
  };
});

/** Formats a number with fixed decimals, or a dash if it is unknown. */
export function fixed(value, decimals = 1) {
  return value === null || value === undefined || Number.isNaN(value)
    ? '–'
    : formats.value.digits[decimals].format(value);
}

export const plain = (value) => (value === null || value === undefined ? '–' : formats.value.any.format(value));

export const time = (at) => formats.value.time.format(new Date(at));

/** Formats a time, with the date unless it is today. */
export function moment(at) {
  const date = new Date(at);
  const isToday = date.toDateString() === new Date(gatewayNow()).toDateString();
  return (isToday ? formats.value.time : formats.value.date).format(date);
}

/** Formats a date with its year and time, for print. */
export const fullDate = (at) => formats.value.full.format(new Date(at));

/** Formats a duration in its largest unit. */
export function span(ms) {
  const seconds = Math.max(0, Math.floor(ms / 1000));
  if (seconds < 60) return t('span.seconds', { count: seconds });
  if (seconds < 3600) return t('span.minutes', { count: Math.floor(seconds / 60) });
  if (seconds < 86400) return t('span.hours', { count: Math.floor(seconds / 3600) });
  return t('span.days', { count: Math.floor(seconds / 86400) });
}

/** The gateway quotes names of fields like code, which is not for people at a panel. */
export const withoutTicks = (text) => text.replaceAll('`', '');

/** Text of a problem: translated if its code and parameters are known, otherwise the gateway's own. */
export function ofProblem(problem) {
  const template = words.value[`problem.${problem.code}`];
  const isWhole = template !== undefined && placeholders(template).every((name) => (problem[name] ?? '') !== '');
  return isWhole ? fill(template, problem) : withoutTicks(problem.detail || problem.title || problem.code);
}
