// Curves of motions, laid over each other: width, speed and force.

import { html, useEffect, useRef, useSignal } from '../lib.js';
import { fixed, moment, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { canPlot, fit, Line, looks, overlaid, plot } from '../ui/plot.js';

const ROWS = [
  ['width', 'width_mm', 'mm'],
  ['speed', 'speed_mm_s', 'mm/s'],
  ['force', 'force_n', 'N'],
];

function Drawn({ curves }) {
  const places = useRef([]);
  const outputs = useRef([]);
  const isDrawn = canPlot();
  useEffect(() => {
    if (!isDrawn) return;
    const mounted = [...places.current];
    const timeText = (value, decimals) => `${fixed(value, decimals)} s`;
    const plots = ROWS.map(([, column], index) =>
      plot(mounted[index], {
        data: overlaid(curves.map((curve) => [curve.t_ms.map((ms) => ms / 1000), curve[column]])),
        timeText,
        output: outputs.current[index],
        group: 'curve',
        padding: [8, 8, 0, 0],
      }),
    );
    const endFitting = fit(plots, mounted);
    return () => {
      endFitting();
      plots.forEach((drawn) => drawn.destroy());
    };
  }, [curves.map(({ id }) => id).join(), looks(), isDrawn]);
  return html`<div>${ROWS.map(
    ([key, , unit], index) => html`<figure class="chart" key=${key}>
    <figcaption>${t(key)} <span class="unit">${unit}</span> <output ref=${(output) => {
      outputs.current[index] = output;
    }} /></figcaption>
    <div class="curve-place" role="img" aria-label=${`${t('history.curve')}: ${t(key)}`}
        ref=${(place) => {
          places.current[index] = place;
        }}></div></figure>`,
  )}</div>`;
}

/** `compares` is a signal. If it is true, another curve is added to the shown curves; otherwise it replaces them. */
export function Curve({ grips, compares }) {
  const curves = useSignal([]);
  const place = useRef(null);
  const wanted = grips.map(({ id }) => id).join();
  useEffect(() => {
    let isNewest = true;
    const known = new Map(curves.peek().map((curve) => [curve.id, curve]));
    Promise.all(grips.map(({ id }) => known.get(id) ?? get(`grips/${id}/curve`).catch(() => null))).then((all) => {
      if (isNewest) curves.value = all.filter(Boolean);
    });
    return () => {
      isNewest = false;
    };
  }, [wanted]);
  useEffect(() => {
    // On small screens, the curves are below the table, so they are scrolled into view.
    if (curves.value.length > 0 && matchMedia('(max-width: 1100px)').matches)
      place.current?.scrollIntoView({ block: 'start' });
  }, [curves.value]);
  return html`<aside class="panel curve" ref=${place} aria-label=${t('history.curve')}>
    <div class="buttons"><button type="button" id="compare" class="quiet" aria-pressed=${compares.value ? 'true' : 'false'}
        onClick=${() => {
          compares.value = !compares.peek();
        }}>${t('history.compare')}</button></div>
    ${grips.length === 0 && html`<p class="muted">${t('history.pick')}</p>`}
    <ul class="lines">${grips.map(
      (grip, index) => html`<li key=${grip.id}><${Line} index=${index} /> <span><strong>${t(`command.${grip.kind}`)}
      </strong> ${t(`outcome.${grip.outcome}`)}${grip.part_id ? ` · ${grip.part_id}` : ''} <span
          class="muted small">${moment(grip.started_at)}</span></span></li>`,
    )}</ul>
    ${curves.value.length > 0 && grips.length > 0 && html`<${Drawn} curves=${curves.value} />`}
  </aside>`;
}
