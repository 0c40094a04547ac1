// The page's WebSocket.

import { Rpc } from '../net/rpc.js';
import { myName } from './name.js';

/** Handlers of the connection, which `feed.js` adds before the first message can arrive. */
export const handlers = { label: () => myName.peek() || undefined };

export const rpc = new Rpc(handlers);
