// Delay before the next try: longer each time, up to a limit, and random so that browsers do not retry all at once.

const FIRST_MS = 200;
const LONGEST_MS = 3000;

export function delay(tries, random = Math.random()) {
  return Math.min(LONGEST_MS, FIRST_MS * 1.7 ** tries) * (0.75 + random / 2);
}
