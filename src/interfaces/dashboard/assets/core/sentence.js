// Maps an event to the key of a text and its parameters. Pure: the texts are in `locales`.

/** Fields with the value of a setting. */
const SETTING_VALUES = ['acceleration_mm_s2', 'force_n', 'minus_mm', 'plus_mm', 'tag', 'finger_set'];

function ofSetting(event) {
  const of = { setting: `setting.${event.setting}` };
  const fields = SETTING_VALUES.filter((field) => event[field] !== undefined);
  if (fields.length) return { key: event.restored ? 'event.setting_restored' : 'event.setting_changed', of, fields };
  if (event.enabled === undefined) return { key: null, of };
  return { key: event.enabled ? 'event.setting_on' : 'event.setting_off', of };
}

const ofServo = ({ adapter, reason }) => ({
  adapter: `adapter.${adapter}`,
  ...(reason === undefined ? {} : { reason: `servo.end.${reason}` }),
});

/**
 * `of` has parameters that are keys of other texts, `with` has plain parameters, `flags` has names of flags, `values` has
 * names of measured values, and `fields` has fields of the event whose values are one parameter.
 */
export function sentence(event) {
  switch (event.kind) {
    case 'command':
      if (event.phase === 'admitted') return { key: 'event.admitted', of: { command: `command.${event.command}` } };
      return { key: null, of: { command: `command.${event.command}`, outcome: `outcome.${event.outcome}` } };
    case 'fast_stop':
      return { key: `event.${event.event}`, of: { cause: `cause.${event.cause}` } };
    case 'acknowledge': {
      const what = event.fast_stop_id ? '' : 'fault_';
      return event.cleared
        ? { key: `event.${what}acknowledged` }
        : { key: `event.${what}not_acknowledged`, with: { cause: event.cause ?? '' } };
    }
    case 'lease':
      return { key: `event.${event.event}`, with: { holder: event.holder } };
    case 'link':
      return { key: `link.${event.link}` };
    case 'device':
      return {
        key: `event.${event.event}`,
        of: event.adapter ? ofServo(event) : {},
        with: {
          count: event.count ?? '',
          cause: event.cause ?? '',
          accepted: event.accepted ?? '',
          refused: event.refused ?? '',
        },
        flags: event.flags,
        values: event.values,
      };
    case 'settings':
      return ofSetting(event);
    case 'refused':
      return { key: 'event.refused', with: { command: event.command } };
    case 'gateway':
      return {
        key: `event.${event.event}`,
        with: { version: event.version ?? '', count: event.count ?? '', changes: event.changes?.join('; ') ?? '' },
      };
    case 'alarm':
      return { key: `event.alarm.${event.event}`, of: { alarm: `alarm.${event.alarm}` } };
    case 'recipe':
      return { key: `event.${event.event}`, with: { number: event.recipe, part: event.definition?.part_id ?? '' } };
    default:
      return { key: null };
  }
}

/** Fields of an event that are shown beside its text. */
const FIELDS = [
  'width_mm',
  'speed_mm_s',
  'force_n',
  'direction',
  'part_id',
  'reason',
  'link_cause',
  'finger',
  'effect',
  'status',
];

export function details(event) {
  const { fields = [], of = {} } = sentence(event);
  const said = [...fields, ...Object.keys(of)];
  const others = FIELDS.filter((field) => !said.includes(field));
  return others
    .filter((field) => event[field] !== undefined && event[field] !== null && event[field] !== '')
    .map((field) => [field, event[field]]);
}
