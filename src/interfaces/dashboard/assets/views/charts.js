// Strip charts of width, speed and force, with marks for grips. The newest values are at the right.

import { html, signal, useComputed, useEffect, useRef } from '../lib.js';
import { fixed, t } from '../model/i18n.js';
import { get } from '../net/rest.js';
import { drawWith } from '../model/screen.js';
import { canPlot, css, fit, looks, plot } from '../ui/plot.js';
import { Choice, Covered, Panel } from '../ui/parts.js';
import { unknownText } from '../ui/unknown.js';

const WINDOWS_S = [10, 30, 120, 600];

/** Limit of the points in a chart: a screen cannot show more. */
const POINTS = 600;

/** Intervals of drawing: of a moving gripper with every second screen update, and of one at rest. */
const MOVING_MS = 230;
const STANDING_MS = 500;

const MARK_SHAPES = { begin: '\u25bd', held: '\u25cf', empty: '\u25a1', wrong: '\u25c6', end: '\u25cb' };

const windowS = signal(30);
/** Time at which the charts were paused; null while they run. */
const pausedAt = signal(null);

const CHARTS = [
  {
    key: 'width',
    name: 'width_mm',
    unit: 'mm',
    column: 1,
    range: (gripper) => [0, gripper.info.peek()?.stroke_mm ?? 110],
  },
  {
    key: 'speed',
    name: 'speed_mm_s',
    unit: 'mm/s',
    column: 2,
    range: (_one, low, high) => [Math.min(-10, low), Math.max(10, high)],
  },
  { key: 'force', name: 'force_n', unit: 'N', column: 3, range: (_one, _low, high) => [0, Math.max(10, high * 1.1)] },
];

function markAt(drawn, marks, until) {
  const { ctx, bbox } = drawn;
  ctx.save();
  ctx.fillStyle = css('--ink-2');
  ctx.strokeStyle = css('--line-strong');
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = 'center';
  for (const { at, kind } of marks) {
    const seconds = (at - until) / 1000;
    if (seconds < drawn.scales.x.min || seconds > 0) continue;
    const x = drawn.valToPos(seconds, 'x', true);
    ctx.beginPath();
    ctx.setLineDash(kind === 'begin' ? [4, 4] : []);
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.fillText(MARK_SHAPES[kind], x, bbox.top + 12 * devicePixelRatio);
  }
  ctx.restore();
}

function make(gripper, chart, { place, output }, until) {
  return plot(place, {
    data: [[], []],
    padding: [8, 16, 0, 0],
    timeText: (value, decimals) => (value === 0 ? t('chart.now') : `${fixed(value, decimals)} s`),
    output,
    group: 'charts',
    xScale: { range: () => [-windowS.peek(), 0] },
    yScale: { range: (_, low, high) => chart.range(gripper, low ?? 0, high ?? 0) },
    hooks: { draw: [(drawn) => markAt(drawn, gripper.marks, until())] },
  });
}

/** Grippers whose charts begin with the gateway's values. */
const filled = new WeakSet();

async function fill(gripper) {
  if (filled.has(gripper)) return;
  filled.add(gripper);
  try {
    gripper.takeTrend(await get(`grippers/${gripper.name}/trend`));
  } catch {
    // Tried again when the charts are shown again.
    filled.delete(gripper);
  }
}

/** Why the chart has a gap at its end. */
function Gap({ gripper, name }) {
  const why = useComputed(() => unknownText(gripper.state.value, name)).value;
  return why && html`<span class="gap-note">– ${why}</span>`;
}

function Charted({ gripper }) {
  const places = useRef([]);
  const outputs = useRef([]);
  const isDrawn = canPlot();
  useEffect(() => {
    fill(gripper);
    if (!isDrawn) return;
    let until = performance.now();
    let drawnAt = 0;
    const mounted = [...places.current];
    const plots = CHARTS.map((chart, index) =>
      make(gripper, chart, { place: mounted[index], output: outputs.current[index] }, () => until),
    );
    const draw = () => {
      until = pausedAt.peek() ?? performance.now();
      const columns = gripper.samples.window(until - windowS.peek() * 1000, until, POINTS);
      plots.forEach((drawn, index) => drawn.setData([columns[0], columns[CHARTS[index].column]]));
      drawnAt = performance.now();
    };
    const isDue = () => performance.now() - drawnAt >= (gripper.isMoving.peek() ? MOVING_MS : STANDING_MS);
    draw();
    const endDrawing = drawWith(() => {
      if (pausedAt.peek() === null && !document.hidden && isDue()) draw();
    });
    const endFitting = fit(plots, mounted);
    return () => {
      endDrawing();
      endFitting();
      plots.forEach((drawn) => drawn.destroy());
    };
  }, [gripper, looks(), windowS.value, isDrawn]);
  return html`<div class="charts">
    ${CHARTS.map(
      (chart, index) => html`<figure class="chart" key=${chart.key}>
      <figcaption>${t(chart.key)} <span class="unit">${chart.unit}</span> <${Gap} gripper=${gripper} name=${chart.name} /> <output ref=${(
        output,
      ) => {
        outputs.current[index] = output;
      }} /></figcaption>
      <div class="chart-place" role="img" aria-label=${t('chart.label', {
        what: t(chart.key),
        seconds: windowS.value,
      })} ref=${(place) => {
        places.current[index] = place;
      }}></div>
    </figure>`,
    )}
  </div>`;
}

export function Charts({ gripper }) {
  const isPaused = pausedAt.value !== null;
  const actions = html`
    <${Choice} label=${t('chart.window')} name="window" value=${windowS.value}
        onChange=${(seconds) => {
          windowS.value = seconds;
        }}
      options=${WINDOWS_S.map((seconds) => [seconds, seconds < 60 ? `${seconds} s` : `${seconds / 60} min`])} />
    <button type="button" class="quiet" aria-pressed=${isPaused ? 'true' : 'false'}
        onClick=${() => {
          pausedAt.value = isPaused ? null : performance.now();
        }}>${t(isPaused ? 'chart.resume' : 'chart.pause')}
          </button>`;
  return html`<${Panel} title=${t('chart.title')} id="chart-title" class="charts-panel" actions=${actions}>
    <${Covered} gripper=${gripper}><${Charted} gripper=${gripper} /></${Covered}>
    <p class="legend muted small">${MARK_SHAPES.begin} ${t('chart.begin')} ${MARK_SHAPES.held} ${t('chart.held')} ${MARK_SHAPES.empty} ${t('chart.empty')} ${MARK_SHAPES.wrong} ${t('chart.wrong')} ${MARK_SHAPES.end} ${t('chart.end')}
      </p>
  </${Panel}>`;
}
