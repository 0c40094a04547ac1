// Health of a gripper and of the gateway, from the gateway's metrics.

import { html, useEffect } from '../lib.js';
import { fixed, plain, span, t } from '../model/i18n.js';
import { now } from '../model/state.js';
import { metrics, samplesOf, figureOf, watchMetrics } from '../model/metrics.js';
import { Facts } from '../ui/facts.js';
import { Panel } from '../ui/parts.js';

/** Growth of a counter between the newest two polls, or null. */
function growth(name, gripper) {
  const { newest, before } = metrics.value;
  const [to, from] = [figureOf(newest, name, gripper), figureOf(before, name, gripper)];
  return to === null || from === null || to < from ? null : to - from;
}

function updateRate(gripper) {
  const { newest, before } = metrics.value;
  const count = growth('wsg_updates_total', gripper);
  return count === null ? null : (count / (newest.at - before.at)) * 1000;
}

/** Mean over the requests since the previous poll, or over all requests if none came since. */
function roundTripMs(gripper) {
  const name = 'wsg_round_trip_seconds';
  const [sum, count] = [growth(`${name}_sum`, gripper), growth(`${name}_count`, gripper)];
  if (count) return (sum / count) * 1000;
  const { newest } = metrics.value;
  const all = figureOf(newest, `${name}_count`, gripper);
  return all ? (figureOf(newest, `${name}_sum`, gripper) / all) * 1000 : null;
}

export function Health({ gripper }) {
  useEffect(watchMetrics, []);
  const { newest } = metrics.value;
  const count = (name) => plain(figureOf(newest, name, gripper.name));
  const [gateway] = samplesOf(newest, 'wsg_build_info');
  const [started] = samplesOf(newest, 'process_start_time_seconds');
  const rate = updateRate(gripper.name);
  const trip = roundTripMs(gripper.name);
  return html`<${Panel} title=${t('health.title')} id="health-title"><${Facts} facts=${[
    ['health.updates', rate === null ? '–' : t('health.per_second', { count: fixed(rate, 0) })],
    ['health.round_trip', trip === null ? '–' : `${fixed(trip, 2)} ms`],
    ['health.damaged', count('wsg_checksum_errors_total')],
    ['health.timeouts', count('wsg_timeouts_total')],
    ['health.reconnects', count('wsg_reconnects_total')],
    ['health.gateway', gateway ? `${gateway.labels.gateway}, ${gateway.labels.version}` : '–'],
    ['health.uptime', started ? span(now.value - started.value * 1000) : '–'],
  ]} /></${Panel}>`;
}
