// The alarms that this page shows: those of the gateway, which all clients share, and its own one.

import { computed, signal } from '../lib.js';
import { acknowledged, noGateway } from '../core/alarms.js';
import { gatewayNow } from '../core/clock.js';
import { paced } from '../core/paced.js';

/** Alarms of the gateway, as last received. */
const ofGateway = signal([]);
/** Alarm of a lost gateway, or null. */
const ofPage = signal(null);

export const alarms = computed(() => (ofPage.value ? [ofPage.value, ...ofGateway.value] : ofGateway.value));

export function takeAlarms({ alarms: all }) {
  ofGateway.value = all;
}

/** Notes whether the gateway is gone. */
export function noteGateway(isGone) {
  ofPage.value = noGateway(ofPage.peek(), isGone, new Date(gatewayNow()).toISOString());
}

/** Limit of the FAST STOPs that are acknowledged at the same time. */
const MAX_AT_ONCE = 8;

/**
 * Acknowledges these alarms, and no others. A latched FAST STOP is acknowledged by its own id, which also acknowledges
 * its alarm. Returns the problems of those that were refused, each with its alarm.
 */
export async function acknowledgeAlarms(rpc, chosen) {
  const isLatch = (alarm) => alarm.alarm === 'fast_stop';
  const inTurn = paced(MAX_AT_ONCE);
  const refused = [];
  const sent = chosen
    .filter(isLatch)
    .map((alarm) =>
      inTurn(() => rpc.call('acknowledge', { gripper: alarm.gripper, fast_stop_id: alarm.fast_stop_id })).catch(
        (problem) => refused.push({ alarm, problem }),
      ),
    );
  const others = chosen.filter((alarm) => !isLatch(alarm) && alarm !== ofPage.peek());
  if (others.length > 0) {
    const ids = others.map(({ id }) => id);
    sent.push(rpc.call('alarms.acknowledge', { ids }).catch((problem) => refused.push({ alarm: others[0], problem })));
  }
  if (chosen.includes(ofPage.peek())) ofPage.value = acknowledged(ofPage.peek(), new Date(gatewayNow()).toISOString());
  await Promise.all(sent);
  return refused;
}
