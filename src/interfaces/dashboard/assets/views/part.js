// Contact widths of one part: their trend and histogram, with the limits of its recipe.

import { html, useEffect, useMemo, useRef, useSignal } from '../lib.js';
import { fixed, moment, plain, t } from '../model/i18n.js';
import { get, query } from '../net/rest.js';
import { Facts } from '../ui/facts.js';
import { canPlot, fit, Line, looks, MAX_LINES, plot } from '../ui/plot.js';
import { averages, histogram } from '../core/statistics.js';

/** Size of the histogram in units of its view box. */
const [WIDTH, HEIGHT] = [400, 120];

/** Whether the statistics count the contact width of a grip. */
const isMeasured = ({ outcome, contact_width_mm: width }) =>
  width !== null && ['PART_HELD', 'WRONG_PART'].includes(outcome);

const LINES = ['part.width', 'part.average', 'recipe.accept_min_mm', 'recipe.accept_max_mm'];

/** The contact widths over the grips. `grips` has the oldest first, `limits` the smallest and the largest accepted width. */
function Trend({ grips, limits }) {
  const place = useRef(null);
  const output = useRef(null);
  const widths = grips.map(({ contact_width_mm: width }) => width);
  const isDrawn = canPlot();
  useEffect(() => {
    if (!isDrawn) return;
    const mounted = place.current;
    const drawn = plot(mounted, {
      data: [
        grips.map((_, index) => index + 1),
        widths,
        averages(widths),
        ...limits.map((limit) => widths.map(() => limit)),
      ],
      // Between two numbers, there is no grip.
      timeText: (value) => (Number.isInteger(value) ? plain(value) : ''),
      atText: (value) => moment(grips[value - 1].started_at),
      output: output.current,
      group: 'part',
      padding: [8, 8, 0, 0],
    });
    const endFitting = fit([drawn], [mounted]);
    return () => {
      endFitting();
      drawn.destroy();
    };
  }, [grips, limits.join(), looks(), isDrawn]);
  const isShown = (index) => index < 2 || limits[index - 2] !== null;
  return html`<figure class="chart"><figcaption>${t('part.trend')} <span class="unit">mm</span> <output ref=${output} />
    </figcaption>
    <div class="curve-place" role="img" aria-label=${t('part.trend')} ref=${place}></div>
    <ul class="lines">${LINES.map(
      (key, index) => isShown(index) && html`<li key=${key}><${Line} index=${index} /> ${t(key)}</li>`,
    )}</ul></figure>`;
}

/** How often each contact width occurred. */
function Histogram({ widths, limits }) {
  const bars = histogram(widths);
  const ends = [bars[0].from, bars.at(-1).to, ...limits.filter((limit) => limit !== null)];
  const [least, most] = [Math.min(...ends), Math.max(...ends)];
  const highest = Math.max(...bars.map(({ count }) => count));
  const x = (mm) => ((mm - least) / (most - least)) * WIDTH;
  const y = (count) => HEIGHT - (count / highest) * HEIGHT;
  const said = bars
    .filter(({ count }) => count > 0)
    .map(({ from, to, count }) => `${fixed(from, 3)} – ${fixed(to, 3)} mm: ${count}`);
  return html`<figure class="chart"><figcaption>${t('part.histogram')} <span class="unit">mm</span></figcaption>
    <svg class="histogram" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} preserveAspectRatio="none" role="img"
        aria-label=${`${t('part.histogram')}: ${said.join(', ')}`}>
      ${bars.map(
        ({ from, to, count }) => html`<rect key=${from} x=${x(from)} width=${x(to) - x(from)} y=${y(count)}
            height=${HEIGHT - y(count)}><title>${`${fixed(from, 3)} – ${fixed(to, 3)} mm: ${count}`}</title></rect>`,
      )}
      ${limits.map(
        (limit, index) =>
          limit !== null && html`<line key=${index} x1=${x(limit)} x2=${x(limit)} y1="0" y2=${HEIGHT} />`,
      )}
    </svg>
    <p class="histogram-ends small muted"><span>${fixed(least, 3)}</span><span>${fixed(most, 3)}</span></p></figure>`;
}

/** `part` is a group of `perPart`, `filters` selects its grips, and `onCurves` takes grips to compare. */
export function PartReport({ part: { part, grips }, filters: { gripper, from, to }, onCurves }) {
  const statistics = useSignal(null);
  useEffect(() => {
    let isWanted = true;
    get(`grips/statistics?${query({ part_id: part, gripper, from, to })}`).then(
      (known) => {
        if (isWanted) statistics.value = known;
      },
      () => {},
    );
    return () => {
      isWanted = false;
    };
  }, [grips]);
  const known = statistics.value;
  const measured = useMemo(() => grips.filter(isMeasured).reverse(), [grips]);
  const limits = [known?.accept_min_mm ?? null, known?.accept_max_mm ?? null];
  return html`<section class="part-report" aria-label=${`${t('part.title')}: ${part}`}>
    <div class="panel-head"><h3>${t('part.title')}: ${part}</h3><div class="panel-actions"><button type="button"
        id="part-curves" onClick=${() => onCurves(grips.slice(0, MAX_LINES))}>${t('part.curves')}</button></div></div>
    ${
      measured.length === 0
        ? html`<p class="muted">${t('part.none')}</p>`
        : html`<div class="pair"><${Trend} grips=${measured} limits=${limits} /><${Histogram}
            widths=${measured.map(({ contact_width_mm: width }) => width)} limits=${limits} /></div>`
    }
    <${Facts} facts=${[
      ['part.all', known && plain(known.count)],
      [
        'part.mean',
        known && `${fixed(known.contact_width_mm.mean, 3)} ± ${fixed(known.contact_width_mm.standard_deviation, 3)} mm`,
      ],
      ['part.average', known && `${fixed(known.moving_average_mm, 3)} mm`],
      ['part.cpk', known && (known.cpk === null ? '–' : fixed(known.cpk, 2))],
    ]} />
  </section>`;
}
