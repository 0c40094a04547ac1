// Small parts of the panels.

import { html, useMemo, useSignal } from '../lib.js';
import { cut } from '../core/bytes.js';
import { isActive } from '../core/alarms.js';
import { ordered } from '../core/newest.js';
import { lacksFlags } from '../core/values.js';
import { alarms } from '../model/alarms.js';
import { breakable, fixed, ofProblem, span, t, time, withoutTicks } from '../model/i18n.js';
import { connection, heardAt, now } from '../model/state.js';
import { valueNames } from './unknown.js';

/** Shapes beside words, so that colour is never the only sign. */
const SHAPES = {
  critical: 'M8 1 15.5 15H.5z',
  high: 'M8 .8 15.2 8 8 15.2.8 8z',
  low: 'M2 2h12v12H2z',
  on: 'M8 2a6 6 0 1 1 0 12A6 6 0 0 1 8 2z',
  off: 'M8 2a6 6 0 1 1 0 12A6 6 0 0 1 8 2zm0 2a4 4 0 1 0 0 8 4 4 0 0 0 0-8z',
  moving: 'M1 8l5-5v3h4V3l5 5-5 5v-3H6v3z',
  check: 'M2 8.5 4 6.5l3 3 5.5-6 2 2L7 13.5z',
  lock: 'M4 7V5a4 4 0 0 1 8 0v2h1v8H3V7zm2 0h4V5a2 2 0 0 0-4 0z',
  next: 'M2 6.5h7V2l6 6-6 6V9.5H2z',
  pen: 'M1.5 14.5l.9-4L11 2l3 3-8.5 8.6z',
  held: 'M0 1h4v14H0zm12 0h4v14h-4zM5 4h6v8H5z',
  empty: 'M0 1h4v14H0zm12 0h4v14h-4z',
  lost: 'M0 1h4v8H0zm12 0h4v8h-4zM5 3h6v2H5zm1.5 5h3v3H12l-4 4.5L4 11h2.5z',
};

export function Shape({ name }) {
  return html`<svg class=${`shape shape-${name}`} viewBox="0 0 16 16" aria-hidden="true"><path d=${SHAPES[name]} />
    </svg>`;
}

/** A name, which can be broken after its separators. */
export function Name({ text }) {
  return html`<span class="name">${breakable(text)}</span>`;
}

export function Panel({ title, id, actions, class: extra = '', children }) {
  return html`<section class=${`panel ${extra}`} aria-labelledby=${id}>
    <header class="panel-head"><h2 id=${id} tabindex="-1">${title}</h2><div class="panel-actions">${actions}</div></header>
    ${children}
  </section>`;
}

/** Alarms that begin with the loss of a link. */
const LINK_ALARMS = ['not_reached', 'link_down', 'link_released'];

/** Time at which the gateway has lost the link; null if no alarm shows it. */
function linkAlarmAt(gripper) {
  const ofLink = (alarm) => alarm.gripper === gripper.name && LINK_ALARMS.includes(alarm.alarm) && isActive(alarm);
  const alarm = alarms.value.find(ofLink);
  return alarm ? Date.parse(alarm.began_at) : null;
}

/**
 * Why and since when the shown values are old or unknown; null while they are current. `sinceKey` is the key of the text
 * about the time.
 */
export function whyOld(gripper) {
  if (connection.value === 'connecting') return { text: t('stale.connecting') };
  if (connection.value !== 'live') {
    return { text: t(`stale.${connection.value}`), since: heardAt.value, sinceKey: 'stale.since' };
  }
  if (gripper && gripper.link.value !== null && gripper.link.value !== 'connected') {
    const since = gripper.lostAt.value ?? linkAlarmAt(gripper);
    const detail = gripper.linkCause.value;
    if (lacksFlags(gripper.state.value)) {
      const text = t('stale.flags', { values: valueNames(gripper.state.value.stale) });
      return { text, since, sinceKey: 'stale.flags_since', detail };
    }
    return { text: t(`stale.link.${gripper.link.value}`), since, sinceKey: 'stale.link_since', detail };
  }
  return null;
}

/**
 * Covers old and unknown values and shows since when, so that they never look live. The elements stay, with what a
 * person has typed or opened in them.
 */
export function Covered({ gripper, children }) {
  const old = whyOld(gripper);
  return html`<div class=${old ? 'covered' : 'uncovered'}>
    <div class=${old ? 'covered-content' : 'uncovered'} inert=${old !== null}
        aria-hidden=${old ? 'true' : undefined}>${children}</div>
    ${
      old &&
      html`<div class="cover">
      <p><${Shape} name="high" /> <strong>${old.text}</strong></p>
      ${old.since && html`<p>${t(old.sinceKey, { time: time(old.since), span: span(now.value - old.since) })}</p>`}
      ${old.detail && html`<p class="muted" lang="en">${old.detail}</p>`}
    </div>`
    }
  </div>`;
}

export function ProblemNote({ problem }) {
  const known = problem.value;
  return html`<div class="problem-place" role="alert">
    ${
      known &&
      html`<div class="problem"><${Shape} name="high" /><div>
      <p>${ofProblem(known)}</p>
      ${known.detail && html`<p class="muted small" lang="en">${withoutTicks(known.detail)}</p>`}
    </div></div>`
    }
  </div>`;
}

/**
 * Returns a signal and a function. The signal holds the answer to the newest of the component's requests that have been
 * answered. Call the function for each request; its result takes the answer.
 */
export function useNewest() {
  const known = useSignal(null);
  const asked = useMemo(ordered, []);
  const asking = () => {
    const isNewest = asked();
    return (answer) => {
      if (isNewest()) known.value = answer;
    };
  };
  return [known, asking];
}

/** The gateway's limit of a part's id. */
export const MAX_PART_BYTES = 48;

/** Handler for input to a text field, which is cut to the gateway's limit. */
export const within =
  (maxBytes, take) =>
  ({ currentTarget: field, isComposing }) => {
    const text = cut(field.value, maxBytes);
    // An input method is still composing.
    if (text !== field.value && !isComposing) field.value = text;
    take(text);
  };

/** Buttons for a few choices, with one selected. */
export function Choice({ label, name, options, value, onChange }) {
  return html`<div class="segments" role="group" aria-label=${label}>
    ${options.map(
      ([key, text]) => html`<button type="button" key=${key} data-choice=${`${name}-${key}`}
        aria-pressed=${key === value ? 'true' : 'false'} onClick=${() => onChange(key)}>${text}</button>`,
    )}
  </div>`;
}

/** Shape beside a gripper's name. */
export function shapeOf(gripper) {
  if (whyOld(gripper)) return 'high';
  if (gripper.latchId.value) return 'critical';
  if (gripper.condition.value === null || gripper.isMoving.value === null) return 'off';
  return gripper.isMoving.value ? 'moving' : 'on';
}

/**
 * A big number. `why` is the reason that it is unknown, and replaces the note. `timed` names its first paint in the
 * browser's performance entries.
 */
export function Figure({ label, value, decimals, unit, note, why, timed, class: extra = '' }) {
  return html`<div class=${`figure ${extra}`}>
    <span class="figure-label">${label}</span>
    <span class="figure-value" title=${why} elementtiming=${timed}>${fixed(value, decimals)}${!why && html`<span class="unit">${unit}</span>`}</span>
    <span class="figure-note">${why ?? note ?? ''}</span>
  </div>`;
}

/**
 * Handlers of a button that acts on touch, not only on release: also with another finger on the screen, and if the
 * finger slides. Keys and screen readers click.
 */
export const onPress = (act) => ({
  onPointerDown: () => act(),
  onClick: (event) => {
    if (event.detail === 0) act();
  },
});
