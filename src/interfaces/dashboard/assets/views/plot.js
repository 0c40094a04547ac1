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

/** `x` is added to the time axis; `xScale`, `yScale`, `padding` and `hooks` are uPlot's. */
export function plot(place, { data, x, xScale = {}, yScale = {}, padding, hooks = {} }) {
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
      cursor: { show: false },
      padding,
      scales: { x: { time: false, ...xScale }, y: yScale },
      axes: [
        axis({ size: 20, ...x }),
        axis({ size: 44, space: 26, values: (_, splits) => splits.map((value) => fixed(value, 0)) }),
      ],
      series: [{}, { stroke: css('--trace'), width: 1.5, points: { show: false }, spanGaps: false }],
      hooks,
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
