// Jogs in the records: a jog is a move to the end of the stroke that is cancelled when the button is released.

const PREFIX = 'jog-';

/** Request id of a jog, by which its record is recognized. */
export function newJogId() {
  const random = crypto.getRandomValues(new Uint8Array(8));
  return PREFIX + Array.from(random, (byte) => byte.toString(16).padStart(2, '0')).join('');
}

/** Whether a record or an event is that of a jog. */
export const isJog = ({ request_id: id }) => typeof id === 'string' && id.startsWith(PREFIX);

/** Whether a jog has ended as it should: the button was released, or the end was reached. */
export const isJogDone = (record) => isJog(record) && ['ABORTED', 'SUCCESS'].includes(record.outcome);
