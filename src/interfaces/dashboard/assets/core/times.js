// Times of the history's filters: local in the fields, and instants for the gateway.

/** Latest time that a field takes: the gateway reads years of four digits. */
export const LATEST = '9999-12-31T23:59';

/** The instant of a local time; empty for none, and null for one that is not valid. */
export function instant(local) {
  if (local === '') return '';
  const date = new Date(local);
  return local > LATEST || Number.isNaN(date.getTime()) ? null : date.toISOString();
}

/** A local time for the fields. */
export function localText(ms) {
  const date = new Date(ms);
  return new Date(ms - date.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
}

const HOUR_MS = 3_600_000;

/** Hours of the day at which shifts begin. */
const SHIFTS_BEGIN = [6, 14, 22];

/** Beginnings of the ranges that one touch chooses. */
export const RANGES = {
  hour: (now) => now - HOUR_MS,
  shift: (now) => {
    const begin = new Date(now);
    const hour = [...SHIFTS_BEGIN].reverse().find((each) => each <= begin.getHours()) ?? SHIFTS_BEGIN.at(-1);
    if (hour > begin.getHours()) begin.setDate(begin.getDate() - 1);
    return begin.setHours(hour, 0, 0, 0);
  },
  today: (now) => new Date(now).setHours(0, 0, 0, 0),
};
