// How long to wait before the next try: longer each time, up to a bound, and not all browsers at once.

const FIRST_MS = 200;
const LONGEST_MS = 3000;

export function delay(tries, random = Math.random()) {
  return Math.min(LONGEST_MS, FIRST_MS * 1.7 ** tries) * (0.75 + random / 2);
}
