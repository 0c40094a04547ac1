// The curve of one motion: width, speed and force.

import { html, useEffect, useRef, useSignal } from '../lib.js';
import uPlot from '../vendor/uplot.js';
import { fixed, language, t } from '../model/i18n.js';
import { theme } from '../model/prefs.js';
import { get } from '../net/rest.js';

const ROWS = [['width', 'width_mm', 'mm'], ['speed', 'speed_mm_s', 'mm/s'], ['force', 'force_n', 'N']];

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function plot(place, times, values) {
  const axis = (more) => ({ stroke: css('--ink-2'), font: '11px system-ui, sans-serif', grid: { stroke: css('--grid'),
      width: 1 }, ticks: { show: false }, ...more });
  return new uPlot({
    width: place.clientWidth,
    height: place.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    padding: [8, 8, 0, 0],
    scales: { x: { time: false } },
    axes: [axis({ size: 20, values: (_, splits) => splits.map((value) => `${fixed(value, 1)} s`) }), axis({ size: 44,
        values: (_, splits) => splits.map((value) => fixed(value, 0)) })],
    series: [{}, { stroke: css('--trace'), width: 1.5, points: { show: false } }],
  }, [times, values], place);
}

function Drawn({ curve }) {
  const places = useRef([]);
  const looks = `${theme.value} ${language.value}`;
  useEffect(() => {
    const times = curve.t_ms.map((ms) => ms / 1000);
    const plots = ROWS.map(([, column], index) => plot(places.current[index], times, curve[column]));
    return () => plots.forEach((one) => one.destroy());
  }, [curve, looks]);
  return html`<div>${ROWS.map(([key, , unit], index) => html`<figure class="chart" key=${key}>
    <figcaption>${t(key)} <span class="unit">${unit}</span></figcaption>
    <div class="curve-place" role="img" aria-label=${`${t('history.curve')}: ${t(key)}`}
        ref=${(place) => { places.current[index] = place; }}></div></figure>`)}</div>`;
}

export function Curve({ grip }) {
  const curve = useSignal(null);
  useEffect(() => {
    curve.value = null;
    if (grip) get(`grips/${grip.id}/curve`).then((told) => { curve.value = told; }, () => {});
  }, [grip?.id]);
  return html`<aside class="panel" aria-label=${t('history.curve')}>
    ${!grip && html`<p class="muted">${t('history.pick')}</p>`}
    ${grip && html`<p><strong>${t(`command.${grip.kind}`)}
      </strong> ${t(`outcome.${grip.outcome}`)}${grip.part_id ? ` · ${grip.part_id}` : ''}</p>`}
    ${curve.value && curve.value.id === grip?.id && html`<${Drawn} curve=${curve.value} />`}
  </aside>`;
}
