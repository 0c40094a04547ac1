// Base of the strip charts and the curves: one trace over time, in the colours of the page.

import uPlot from '../vendor/uplot.js';
import { fixed, language } from '../model/i18n.js';
import { isDark } from '../model/prefs.js';

// Loaded here, because the page does not need this style before its first plot.
const style = document.createElement('link');
style.rel = 'stylesheet';
style.href = new URL('../vendor/uplot.css', import.meta.url).href;
document.head.append(style);

export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Theme and language of a plot, which is recreated when they change. */
export const looks = () => `${isDark.value} ${language.value}`;

/** Decimals that make neighbouring labels of an axis distinct. */
const decimals = (step) => Math.min(2, Math.max(0, Math.ceil(-Math.log10(step))));

const MAX_DECIMALS = 2;

/** Shows the value under the cursor. The cursor is at the same time in all plots of a group. */
function readout(output) {
  return (drawn) => {
    const { idx } = drawn.cursor;
    const value = idx == null ? null : drawn.data[1][idx];
    output.textContent =
      value == null ? '' : `${fixed(value, MAX_DECIMALS)} (${fixed(drawn.data[0][idx], MAX_DECIMALS)} s)`;
  };
}

/**
 * `timeText` formats a label of the time axis from its value and decimals; `output` gets the value under the cursor of
 * all plots with the same `group`. `xScale`, `yScale`, `padding` and `hooks` are uPlot's.
 */
export function plot(place, { data, timeText, output, group, xScale = {}, yScale = {}, padding, hooks = {} }) {
  const axis = (more) => ({
    stroke: css('--ink-2'),
    font: '11px system-ui, sans-serif',
    grid: { stroke: css('--grid'), width: 1 },
    ticks: { show: false },
    ...more,
  });
  return new uPlot(
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
      series: [{}, { stroke: css('--trace'), width: 1.5, points: { show: false }, spanGaps: false }],
      hooks: { ...hooks, setCursor: [readout(output)] },
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
