// Kinds of commands.

/** Whether a command grips: a part, or a gauge. */
export const isGrip = (kind) => kind === 'grip' || kind === 'reference';
