// Base of the strip charts and the curves: lines over time, in the colours of the page.

import { html } from '../lib.js';
import { plotClass } from '../loading.js';
import { decimals, MAX_DECIMALS } from '../core/decimals.js';
import { fixed, language } from '../model/i18n.js';
import { isDark } from '../model/prefs.js';

export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Theme and language of a plot, which is recreated when they change. */
export const looks = () => `${isDark.value} ${language.value}`;

/** Styles of a plot's lines, which differ in more than colour. */
const LINES = [
  { colour: '--trace', dash: [] },
  { colour: '--accent', dash: [8, 4] },
  { colour: '--trace', dash: [2, 3] },
  { colour: '--accent', dash: [10, 3, 2, 3] },
];

export const MAX_LINES = LINES.length;

/** Sample of a line, for a legend. */
export function Line({ index }) {
  const { colour, dash } = LINES[index];
  return html`<svg class="line" viewBox="0 0 32 8" aria-hidden="true"><path d="M0 4h32" stroke=${`var(${colour})`}
      stroke-dasharray=${dash.join(' ')} /></svg>`;
}

/** Value of a line at a time, interpolated between its samples; null outside the line's times. */
function valueAt([times, values], time) {
  const next = times.findIndex((one) => one >= time);
  if (next < 0 || time < times[0]) return null;
  if (times[next] === time) return values[next];
  const [from, to] = [values[next - 1], values[next]];
  const share = (time - times[next - 1]) / (times[next] - times[next - 1]);
  return from === null || to === null ? null : from + (to - from) * share;
}

/** Puts several lines, each `[times, values]`, on one time axis with the times of all lines. */
export function overlaid(lines) {
  if (lines.length === 1) return lines[0];
  const times = [...new Set(lines.flatMap(([own]) => own))].sort((a, b) => a - b);
  return [times, ...lines.map((line) => times.map((time) => valueAt(line, time)))];
}

const seconds = (value) => `${fixed(value, MAX_DECIMALS)} s`;

/** Shows the values under the cursor. All plots of a group share one cursor. */
function readout(output, atText) {
  return (drawn) => {
    const { idx } = drawn.cursor;
    const [times, ...lines] = drawn.data;
    const values = idx == null ? [] : lines.map((line) => line[idx]).filter((value) => value != null);
    output.textContent =
      values.length === 0
        ? ''
        : `${values.map((value) => fixed(value, MAX_DECIMALS)).join(' / ')} (${atText(times[idx])})`;
  };
}

/** Whether the library that draws plots is loaded. */
export const canPlot = () => plotClass.value !== null;

/**
 * Draws a plot, once `canPlot` is true. `timeText` formats a label of the time axis from its value and decimals. `output`
 * shows the value under the cursor, which all plots with the same `group` share, and `atText` formats its value on the x
 * axis. `xScale`, `yScale`, `padding` and `hooks` are uPlot's.
 */
export function plot(
  place,
  { data, timeText, atText = seconds, output, group, xScale = {}, yScale = {}, padding, hooks = {} },
) {
  const axis = (more) => ({
    stroke: css('--ink-2'),
    font: '11px system-ui, sans-serif',
    grid: { stroke: css('--grid'), width: 1 },
    ticks: { show: false },
    ...more,
  });
  const Class = plotClass.peek();
  return new Class(
    {
      width: place.clientWidth,
      height: place.clientHeight,
      legend: { show: false },
      cursor: { y: false, drag: { x: false }, points: { size: 6 }, sync: { key: group, setSeries: false } },
      padding,
      scales: { x: { time: false, ...xScale }, y: yScale },
      axes: [
        axis({
          size: 20,
          space: 70,
          values: (_drawn, splits, _axis, _space, step) => splits.map((value) => timeText(value, decimals(step))),
        }),
        axis({
          size: 44,
          space: 26,
          values: (_drawn, splits, _axis, _space, step) => splits.map((value) => fixed(value, decimals(step))),
        }),
      ],
      series: [
        {},
        ...LINES.slice(0, data.length - 1).map(({ colour, dash }) => ({
          stroke: css(colour),
          dash,
          width: 1.5,
          points: { show: false },
          spanGaps: false,
        })),
      ],
      hooks: { ...hooks, setCursor: [readout(output, atText)] },
    },
    data,
    place,
  );
}

/** Keeps plots as large as their places until the returned function is called. */
export function fit(plots, places) {
  const resized = new ResizeObserver(() =>
    plots.forEach((one, index) => {
      const { clientWidth: width, clientHeight: height } = places[index];
      if (width > 0 && (width !== one.width || height !== one.height)) one.setSize({ width, height });
    }),
  );
  places.forEach((place) => resized.observe(place));
  return () => resized.disconnect();
}
