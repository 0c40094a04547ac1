// Checks of a page's accessibility and layout.

import { readFileSync } from 'node:fs';

import { AXE } from './harness.mjs';

const axe = readFileSync(AXE, 'utf8');

/** Returns what axe finds. */
export async function violations(page) {
  // Injects the checker through the debugger, which the page's content security policy does not restrict.
  await page.evaluate(axe);
  const { violations: found } = await page.evaluate(() =>
    globalThis.axe.run(document, {
      runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'],
    }),
  );
  return found.map(({ id, nodes }) => ({
    id,
    nodes: nodes.map(({ target, failureSummary }) => `${target}: ${failureSummary}`),
  }));
}

/** Finds elements wider than the screen or too small to touch. The window's own width grows with its content. */
export async function misfits(page) {
  return page.evaluate((width) => {
    const small = [...document.querySelectorAll('button, select, input, a[href], summary')]
      .filter((one) => one.checkVisibility() && !one.closest('[inert]') && !one.matches('.byte, .frame, .skip'))
      .map((one) => ({ one, box: one.getBoundingClientRect() }))
      .filter(({ box }) => box.height < 43.5 || box.width < 24)
      .map(({ one, box }) => `${one.outerHTML.slice(0, 90)} is ${Math.round(box.width)} x ${Math.round(box.height)}`);
    const wide =
      document.documentElement.scrollWidth > width ? [`the page is ${document.documentElement.scrollWidth} wide`] : [];
    const stop = document.querySelector('#stop').getBoundingClientRect();
    if (stop.left < 0 || stop.right > width) wide.push(`STOP is from ${stop.left} to ${stop.right}`);
    return [...wide, ...small];
  }, page.viewportSize().width);
}
