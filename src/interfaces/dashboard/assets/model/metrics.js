// The gateway's metrics, polled while a view shows any of them.

import { signal } from '../lib.js';
import { text } from '../net/rest.js';
import { isLive } from './state.js';

const ASKED_EVERY_MS = 5000;
/** Sample: name, labels and value. */
const LINE = /^(\w+)(?:\{([^}]*)\})? ([\d.e+-]+)$/gm;
const LABEL = /(\w+)="([^"]*)"/g;

/** The newest and the previous samples `[{name, labels, value}]`, each with their time; null until known. */
export const metrics = signal({ newest: null, before: null });

function parse(page) {
  return Array.from(page.matchAll(LINE), ([, name, labels = '', value]) => ({
    name,
    labels: Object.fromEntries(Array.from(labels.matchAll(LABEL), ([, key, given]) => [key, given])),
    value: Number(value),
  }));
}

async function ask() {
  if (!isLive.peek() || document.hidden) return;
  try {
    const page = await text('/metrics', 'text/plain');
    metrics.value = { newest: { samples: parse(page.text), at: performance.now() }, before: metrics.peek().newest };
  } catch {
    metrics.value = { newest: null, before: null };
  }
}

/** Polls until the returned function is called. */
export function watchMetrics() {
  ask();
  const timer = setInterval(ask, ASKED_EVERY_MS);
  return () => clearInterval(timer);
}

/** Samples of a metric. */
export const samplesOf = (page, name) => page?.samples.filter((sample) => sample.name === name) ?? [];

/** Value of a gripper's metric, or null. */
export const figureOf = (page, name, gripper) =>
  samplesOf(page, name).find(({ labels }) => labels.gripper === gripper)?.value ?? null;
