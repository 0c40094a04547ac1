// Uses a gateway with a simulated gripper through the types that openapi-typescript generates: client.js URL
import createClient from 'openapi-fetch';
import type { components, paths } from './api.js';

type Command = components['schemas']['Command'];

const [, , baseUrl] = process.argv;
const client = createClient<paths>({ baseUrl });
const path = { gripper: 'left' };

function check(holds: boolean, what: unknown): asserts holds {
  if (!holds) throw new Error(JSON.stringify(what));
}

/** Waits until a command has ended, and returns it. */
async function ended(reply: { data?: Command; error?: unknown }): Promise<Command> {
  let { data: command } = reply;
  check(command !== undefined, reply.error);
  while (command.outcome === null) {
    const found: { data?: Command; error?: unknown } = await client.GET('/api/v1/grippers/{gripper}/commands/{command}', {
      params: { path: { ...path, command: command.id }, query: { wait_ms: 5000 } },
    });
    check(found.data !== undefined, found.error);
    command = found.data;
  }
  return command;
}

const homed = await ended(await client.POST('/api/v1/grippers/{gripper}/home', { params: { path } }));
check(homed.outcome === 'SUCCESS', homed);

const lease = await client.POST('/api/v1/grippers/{gripper}/lease', {
  params: { path },
  body: { holder: 'typescript client' },
});
check(typeof lease.data?.token === 'string', lease);
const { token } = lease.data;
const move = { width_mm: 50, speed_mm_s: 200 };
const refused = await client.POST('/api/v1/grippers/{gripper}/move', { params: { path }, body: move });
check(refused.error?.code === 'lease_held', refused);

const wanted = { width_mm: 20, speed_mm_s: 100, force_n: 40, part_id: 'P-2', lease: token };
const held = await ended(await client.POST('/api/v1/grippers/{gripper}/grip', { params: { path }, body: wanted }));
check(held.outcome === 'PART_HELD', held);

const stop = { params: { path }, body: { reason: 'typescript client' } };
const stopped = await client.POST('/api/v1/grippers/{gripper}/fast-stop', stop);
check(stopped.data !== undefined, stopped);
const { fast_stop_id } = stopped.data;
const state = await client.GET('/api/v1/grippers/{gripper}/state', { params: { path } });
check(state.data?.fast_stop_id === fast_stop_id, state);
await client.POST('/api/v1/grippers/{gripper}/acknowledge', { params: { path }, body: { fast_stop_id } });

const query = { command_id: held.id, order: 'oldest' } as const;
const events = await client.GET('/api/v1/events', { params: { query } });
// The discriminator narrows the type of the event.
const done = events.data?.events.find((event) => event.kind === 'command' && event.phase === 'done');
check(done?.kind === 'command' && done.outcome === 'PART_HELD' && done.requested_force_n === 40, events);
const stops = await client.GET('/api/v1/events', { params: { query: { kind: 'fast_stop' } } });
check(stops.data?.events.some((event) => event.kind === 'fast_stop' && event.fast_stop_id === fast_stop_id) === true, stops);

// A grip record appears up to a second after the grip's end.
for (let tries = 0; ; tries += 1) {
  const record = await client.GET('/api/v1/grips/{command}', { params: { path: { command: held.id } } });
  if (record.data) {
    check(record.data.part_id === 'P-2' && record.data.holder === 'typescript client', record);
    break;
  }
  check(tries < 100, record.error);
  await new Promise((resolve) => setTimeout(resolve, 100));
}
const grips = await client.GET('/api/v1/grips', { params: { query: { part_id: 'P-2' } } });
check(grips.data?.grips.length === 1, grips);

const released = await client.DELETE('/api/v1/grippers/{gripper}/lease', { params: { path }, body: { lease: token } });
check(released.error === undefined, released);
console.log('generated TypeScript types: home, lease, grip, FAST STOP, events and grips');
