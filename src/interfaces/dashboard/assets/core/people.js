// Names of people. The gateway knows a client only by its interface and address. So the dashboard puts the user's name
// into the reason of a FAST STOP.

/** Name of the dashboard's user in the reason of a FAST STOP, or null. */
export const nameIn = (reason) => /^dashboard, (.+)$/.exec(reason ?? '')?.[1] ?? null;

/** A client with the name of its user, from a reason or as a lease holder: `Anna (10.0.0.5)`. */
export function person(subject, reason, holder = null) {
  const name = nameIn(reason) ?? holder;
  return name === null ? subject : `${name} (${subject.replace(/^\w+:/, '')})`;
}
