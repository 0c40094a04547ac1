// Checks of a page's accessibility and layout.

import { readFileSync } from 'node:fs';

import { AXE } from './harness.mjs';

const axe = readFileSync(AXE, 'utf8');

/** Returns what axe finds. */
export async function violations(page) {
  // Injects the checker through the debugger, which the page's content security policy does not restrict.
  if (await page.evaluate(() => globalThis.axe === undefined)) await page.evaluate(axe);
  return page.evaluate(async () => {
    const { violations: found } = await globalThis.axe.run(document, {
      runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'],
      // Describing each element that passes takes a third of the time.
      resultTypes: ['violations'],
    });
    return found.map(({ id, nodes }) => ({
      id,
      nodes: nodes.map(({ target, failureSummary }) => `${target}: ${failureSummary}`),
    }));
  });
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

/** Faults of the layout, as texts. */
export function faults(page) {
  return page.evaluate(async () => {
    const found = [];
    const wordsOf = (one) =>
      `${one.id ? `#${one.id}` : one.className || one.localName} "${(one.getAttribute('aria-label') ?? one.innerText ?? '').replace(/\s+/g, ' ').slice(0, 40)}"`;
    const all = [...document.querySelectorAll('button, a[href], input, select, textarea, summary')].filter(
      (one) => one.checkVisibility({ visibilityProperty: true }) && !one.closest('[inert]') && !one.matches('.skip'),
    );
    const layer = (one) => {
      for (let at = one; at !== null; at = at.parentElement) {
        const { position } = getComputedStyle(at);
        if (position === 'fixed' || position === 'sticky') return at;
      }
      return null;
    };
    // 1. No two controls overlap. Content that scrolls below a fixed part is another layer.
    /** The part of an element that no scrolling part around it hides. */
    const seen = (one) => {
      let { left, top, right, bottom } = one.getBoundingClientRect();
      for (let at = one.parentElement; at !== null && at !== document.body; at = at.parentElement) {
        const { overflowX, overflowY } = getComputedStyle(at);
        if (overflowX === 'visible' && overflowY === 'visible') continue;
        const around = at.getBoundingClientRect();
        left = Math.max(left, around.left);
        top = Math.max(top, around.top);
        right = Math.min(right, around.right);
        bottom = Math.min(bottom, around.bottom);
      }
      return { left, top, right, bottom };
    };
    const boxes = all.map((one) => ({ one, layer: layer(one), box: seen(one) }));
    for (const [index, a] of boxes.entries()) {
      for (const b of boxes.slice(index + 1)) {
        if (a.layer !== b.layer || a.one.contains(b.one) || b.one.contains(a.one)) continue;
        const width = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const height = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        // The pencil of a tile is a corner of it.
        const isCorner = a.one.parentElement === b.one.parentElement && b.one.matches('.tile-edit');
        if (width > 1 && height > 1 && !isCorner) found.push(`${wordsOf(a.one)} overlaps ${wordsOf(b.one)}`);
      }
    }
    // 2. Panels do not overlap.
    const panels = [...document.querySelectorAll('main .panel')].map((one) => ({
      one,
      box: one.getBoundingClientRect(),
    }));
    for (const [index, a] of panels.entries()) {
      for (const b of panels.slice(index + 1)) {
        if (a.one.contains(b.one) || b.one.contains(a.one)) continue;
        const width = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const height = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        if (width > 1 && height > 1) found.push(`panel ${a.one.className} overlaps ${b.one.className}`);
      }
    }
    // 3. The page is as wide as the screen, and STOP is on it.
    if (document.documentElement.scrollWidth > innerWidth) {
      found.push(`the page is ${document.documentElement.scrollWidth} wide`);
    }
    const scrolls = (one) => {
      for (let at = one.parentElement; at !== null && at !== document.body; at = at.parentElement) {
        const { overflowX, overflowY } = getComputedStyle(at);
        if (/auto|scroll/.test(overflowX + overflowY)) return at;
      }
      return null;
    };
    // 4. No text is cut by its own element, by one around it, or by the screen, and no word is broken.
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const node = walker.currentNode;
      const one = node.parentElement;
      if (
        node.data.trim() === '' ||
        !one.checkVisibility() ||
        one.closest(
          '[inert], svg, script, noscript, option, canvas, .skip, .visually-hidden, .covered-content, textarea',
        )
      )
        continue;
      if (getComputedStyle(one).clipPath !== 'none' || one.closest('h1, .panel-head')?.offsetWidth === 1) continue;
      const range = document.createRange();
      range.selectNodeContents(node);
      const box = range.getBoundingClientRect();
      const what = `"${node.data.trim().slice(0, 50)}" in ${one.closest('[class]')?.className ?? one.localName}`;
      for (let at = one; at !== null && at !== document.body; at = at.parentElement) {
        const { overflowX, overflowY, display, position } = getComputedStyle(at);
        if (/auto|scroll/.test(overflowX + overflowY)) break;
        if (display === 'inline' || display === 'contents') continue;
        const around = at.getBoundingClientRect();
        const isOut = box.left < around.left - 1 || box.right > around.right + 1;
        const isBelow =
          at.matches('button, .status, .notice, .bar, .now, .outcome, .chip') &&
          (box.bottom > around.bottom + 1 || box.top < around.top - 1);
        if (isOut || isBelow) {
          found.push(`${what} is out of ${at.className || at.localName}`);
          break;
        }
        if (position === 'fixed') break;
      }
      if (box.right > innerWidth + 1 && scrolls(one) === null) found.push(`${what} is beyond the screen`);
      if (one.closest('.notice p') && one.closest('p').scrollHeight > one.closest('p').clientHeight + 2)
        found.push(`${what} does not fit into the strip`);
      if (one.closest('.name, code, dd, td, .cover, .alarm-text, .frame, .hex, .byte, .since')) continue;
      for (const { 0: word, index } of node.data.matchAll(/[\p{L}\d.,]+/gu)) {
        const lines = new Set(
          [index, index + word.length - 1].map((at) => {
            range.setStart(node, at);
            range.setEnd(node, at + 1);
            return Math.round([...range.getClientRects()].at(-1)?.top ?? 0);
          }),
        );
        if (lines.size > 1) found.push(`the word ${word} is broken in ${what}`);
      }
    }
    // 5. Each control can be hit at its middle, once it is scrolled into view.
    for (const one of all) {
      one.scrollIntoView({ block: 'center', inline: 'center', behavior: 'instant' });
      const box = one.getBoundingClientRect();
      const hit = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
      const isHit =
        hit !== null && (one === hit || one.contains(hit) || (hit.contains(one) && hit.localName === 'label'));
      if (!isHit)
        found.push(
          `${wordsOf(one)} is covered by ${hit === null ? 'nothing' : hit.className || hit.localName} at ${Math.round(box.left)},${Math.round(box.top)}`,
        );
    }
    scrollTo(0, 0);
    return [...new Set(found)];
  });
}

/** Places of all controls, by their ids or words. */
export function places(page) {
  return page.evaluate(() => {
    const keyOf = (one) =>
      one.id || one.dataset.choice || one.dataset.view || one.getAttribute('aria-label') || one.innerText;
    const found = {};
    for (const one of document.querySelectorAll('button, a[href], input, select, summary')) {
      if (!one.checkVisibility() || one.closest('.strip, .notices, .alarms-panel')) continue;
      const { left, top, width, height } = one.getBoundingClientRect();
      found[keyOf(one)] = [left, top, width, height].map((value) => Math.round(value)).join(' ');
    }
    return found;
  });
}
