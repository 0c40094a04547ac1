// Adds to each guide a search over all guides, and a button that copies a block of code. Without this script, a guide
// can still be read.

const MOST_RESULTS = 20;
const EXCERPT_BEFORE = 60;
const EXCERPT_LENGTH = 220;

const search = document.querySelector('#search');
const field = search.querySelector('input');
const results = document.querySelector('#results');
const status = results.querySelector('[role=status]');
const list = results.querySelector('ol');

let loading;

/** Loads the sections of all guides, when they are first needed. */
async function sections() {
  loading ??= fetch(new URL('search.json', import.meta.url)).then((response) => {
    if (!response.ok) throw new Error(`status ${response.status}`);
    return response.json();
  });
  try {
    return await loading;
  } catch (error) {
    loading = undefined;
    throw error;
  }
}

/** Returns how well a section fits, or 0 if it lacks a word. A heading counts more than the text. */
function score(section, words) {
  const heading = section.heading.toLowerCase();
  const guide = section.guide.toLowerCase();
  const text = section.text.toLowerCase();
  let sum = 0;
  for (const word of words) {
    const value =
      (heading.includes(word) ? 8 : 0) + (guide.includes(word) ? 2 : 0) + Math.min(text.split(word).length - 1, 3);
    if (value === 0) return 0;
    sum += value;
  }
  const phrase = words.join(' ');
  if (heading === phrase) sum += 20;
  if (words.length > 1 && text.includes(phrase)) sum += 5;
  return sum;
}

/** Returns the text around the first word, with all words marked. */
function excerpt(text, words) {
  const plain = text.replace(/\s+/g, ' ').trim();
  const lower = plain.toLowerCase();
  const places = words.map((word) => lower.indexOf(word)).filter((place) => place >= 0);
  const wanted = places.length > 0 ? Math.max(0, Math.min(...places) - EXCERPT_BEFORE) : 0;
  const begin = wanted > 0 ? plain.indexOf(' ', wanted) + 1 : 0;
  const part = plain.slice(begin, begin + EXCERPT_LENGTH);
  const paragraph = document.createElement('p');
  let rest = part;
  while (rest !== '') {
    const from = rest.toLowerCase();
    const next = words
      .map((word) => ({ word, place: from.indexOf(word) }))
      .filter(({ place }) => place >= 0)
      .sort((one, other) => one.place - other.place)[0];
    if (!next) break;
    const mark = document.createElement('mark');
    mark.textContent = rest.slice(next.place, next.place + next.word.length);
    paragraph.append(rest.slice(0, next.place), mark);
    rest = rest.slice(next.place + next.word.length);
  }
  paragraph.append(rest);
  if (begin > 0) paragraph.prepend('… ');
  if (begin + EXCERPT_LENGTH < plain.length) paragraph.append(' …');
  return paragraph;
}

function item(section, words) {
  const link = document.createElement('a');
  link.href = new URL(`${section.page}#${section.anchor}`, import.meta.url);
  link.textContent = section.heading === section.guide ? section.heading : `${section.heading} (${section.guide})`;
  const entry = document.createElement('li');
  entry.append(link, excerpt(section.text, words));
  return entry;
}

async function show() {
  const asked = field.value;
  const words = asked.toLowerCase().split(/\s+/).filter(Boolean);
  results.hidden = words.length === 0;
  if (words.length === 0) return;
  let all;
  try {
    all = await sections();
  } catch {
    list.replaceChildren();
    status.textContent = 'The gateway does not answer. Type again to repeat the search.';
    return;
  }
  // An older search must not replace a newer one.
  if (asked !== field.value) return;
  const found = all
    .map((section) => ({ section, value: score(section, words) }))
    .filter(({ value }) => value > 0)
    .sort((one, other) => other.value - one.value);
  const shown = found.slice(0, MOST_RESULTS);
  list.replaceChildren(...shown.map(({ section }) => item(section, words)));
  if (found.length === 0) status.textContent = 'No section has all of these words.';
  else if (found.length > shown.length)
    status.textContent = `${found.length} sections, the best ${shown.length} first:`;
  else status.textContent = found.length === 1 ? '1 section:' : `${found.length} sections:`;
}

/** Returns what a reader wants to run or to keep: without the responses between the commands of a shell block. */
function copied(code) {
  const lines = code.textContent.trimEnd().split('\n');
  if (!code.classList.contains('language-sh')) return lines.join('\n');
  return lines
    .filter((line) => !line.startsWith('> '))
    .join('\n')
    .trim();
}

/** Copies without the clipboard interface, which browsers offer only with TLS and on the gateway's own machine. */
function copyBySelection(text) {
  const area = document.createElement('textarea');
  area.value = text;
  document.body.append(area);
  area.select();
  const isCopied = document.execCommand('copy');
  area.remove();
  return isCopied;
}

async function copy(text) {
  if (!navigator.clipboard) return copyBySelection(text);
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return copyBySelection(text);
  }
}

function addCopyButton(pre) {
  const button = document.createElement('button');
  button.type = 'button';
  button.textContent = 'Copy';
  button.addEventListener('click', async () => {
    const isCopied = await copy(copied(pre.querySelector('code')));
    button.textContent = isCopied ? 'Copied' : 'Not copied: select the text';
    button.focus();
  });
  button.addEventListener('blur', () => {
    button.textContent = 'Copy';
  });
  const frame = document.createElement('div');
  frame.className = 'block';
  pre.replaceWith(frame);
  frame.append(pre, button);
}

/** Names the page's icon. Otherwise, a browser asks for one outside of the path below which a proxy serves the gateway. */
function addIcon() {
  const icon = document.createElement('link');
  icon.rel = 'icon';
  icon.href = new URL('../../favicon.ico', import.meta.url);
  document.head.append(icon);
}

addIcon();
search.hidden = false;
search.addEventListener('submit', (event) => {
  event.preventDefault();
  list.querySelector('a')?.focus();
});
field.addEventListener('input', show);
// A browser that goes back restores the words.
show();
document.querySelectorAll('main pre').forEach(addCopyButton);
// A keyboard has to reach what scrolls sideways.
for (const table of document.querySelectorAll('main table')) {
  if (table.scrollWidth > table.clientWidth) table.tabIndex = 0;
}
const contents = document.querySelector('#contents details');
if (contents && matchMedia('(min-width: 80rem)').matches) contents.open = true;
