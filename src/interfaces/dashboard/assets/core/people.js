// Names of people. The gateway knows a client without a credential by its interface and address, and notes the name
// that the client gives beside it. Before a FAST STOP, the name is also in its reason.

/** Name of the dashboard's user in the reason of a FAST STOP, or null. */
export const nameIn = (reason) => /^dashboard, (.+)$/.exec(reason ?? '')?.[1] ?? null;

/** A subject without its interface: an address, or the name of a credential. */
export const plainSubject = (subject) => subject.replace(/^\w+:/, '');

/** A client with the first of these names that is known: `Anna (10.0.0.5)`. */
export function person(subject, ...names) {
  const name = names.find(Boolean);
  return name ? `${name} (${plainSubject(subject)})` : subject;
}
