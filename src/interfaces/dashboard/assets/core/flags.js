// The 32 system state flags (fw4-en appendix), in the order of their bits.

const NAMES = [
  'REFERENCED',
  'MOVING',
  'BLOCKED_MINUS',
  'BLOCKED_PLUS',
  'SOFT_LIMIT_MINUS',
  'SOFT_LIMIT_PLUS',
  'AXIS_STOPPED',
  'TARGET_POS_REACHED',
  'OVERDRIVE_MODE',
  'FORCECNTL_MODE',
  null,
  null,
  'FAST_STOP',
  'TEMP_WARNING',
  'TEMP_FAULT',
  'POWER_FAULT',
  'CURR_FAULT',
  'FINGER_FAULT',
  'CMD_FAILURE',
  'SCRIPT_RUNNING',
  'SCRIPT_FAILURE',
];

const FAULTS = ['TEMP_FAULT', 'POWER_FAULT', 'CURR_FAULT', 'FINGER_FAULT'];
const WARNINGS = ['TEMP_WARNING', 'SCRIPT_FAILURE'];
const STOPS = ['FAST_STOP'];

/** Severity of a flag that is set. */
function weight(name) {
  if (FAULTS.includes(name) || STOPS.includes(name)) return 'fault';
  return WARNINGS.includes(name) ? 'warning' : 'normal';
}

/** All 32 bits; a bit without a name is reserved. */
export const FLAGS = Array.from({ length: 32 }, (_, bit) => ({
  bit,
  name: NAMES[bit] ?? null,
  weight: weight(NAMES[bit]),
}));

export const isSet = (raw, bit) => raw !== null && raw !== undefined && ((raw >>> bit) & 1) === 1;

export const has = (raw, name) => isSet(raw, NAMES.indexOf(name));
