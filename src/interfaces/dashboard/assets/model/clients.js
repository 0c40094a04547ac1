// Number of connected clients by interface, from the gateway's metrics.

import { computed } from '../lib.js';
import { metrics, samplesOf } from './metrics.js';

export const clients = computed(() =>
  samplesOf(metrics.value.newest, 'wsg_clients_connected')
    .map(({ labels, value }) => ({ door: labels.door, count: value }))
    .filter(({ count }) => count > 0),
);
