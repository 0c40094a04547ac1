// The curve of one motion: width, speed and force.

import { html, useEffect, useRef, useSignal } from '../lib.js';
import { fixed, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { fit, looks, plot } from './plot.js';

const ROWS = [
  ['width', 'width_mm', 'mm'],
  ['speed', 'speed_mm_s', 'mm/s'],
  ['force', 'force_n', 'N'],
];

function Drawn({ curve }) {
  const places = useRef([]);
  const outputs = useRef([]);
  useEffect(() => {
    const mounted = [...places.current];
    const times = curve.t_ms.map((ms) => ms / 1000);
    const timeText = (value, decimals) => `${fixed(value, decimals)} s`;
    const plots = ROWS.map(([, column], index) =>
      plot(mounted[index], {
        data: [times, curve[column]],
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
  }, [curve, looks()]);
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

export function Curve({ grip }) {
  const curve = useSignal(null);
  const place = useRef(null);
  useEffect(() => {
    curve.value = null;
    if (grip)
      get(`grips/${grip.id}/curve`).then(
        (answer) => {
          curve.value = answer;
        },
        () => {},
      );
  }, [grip?.id]);
  useEffect(() => {
    // Below the table on small screens, and beside it on others.
    if (curve.value && matchMedia('(max-width: 1100px)').matches) place.current?.scrollIntoView({ block: 'start' });
  }, [curve.value]);
  return html`<aside class="panel curve" ref=${place} aria-label=${t('history.curve')}>
    ${!grip && html`<p class="muted">${t('history.pick')}</p>`}
    ${
      grip &&
      html`<p><strong>${t(`command.${grip.kind}`)}
      </strong> ${t(`outcome.${grip.outcome}`)}${grip.part_id ? ` · ${grip.part_id}` : ''}</p>`
    }
    ${curve.value && curve.value.id === grip?.id && html`<${Drawn} curve=${curve.value} />`}
  </aside>`;
}
