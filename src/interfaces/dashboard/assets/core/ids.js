// Ids for people.

/** End of an id, short enough to read aloud. */
export const shortId = (id) => id.slice(-4);

/** Delay before something new can be acknowledged, so that a tap meant for an older one does not clear it. */
export const SEEN_AFTER_MS = 800;
