// JSON-RPC 2.0 over one WebSocket, which is made again whenever it ends.

import { delay } from '../core/backoff.js';

const SUBPROTOCOL = 'wsg.v1';

/** A connection that isn't there by then is tried anew. */
const CONNECTS_WITHIN_MS = 3000;

/** What an answer may take: a device at 9600 baud is slow, and says so within this. */
const ANSWERS_WITHIN_MS = 8000;

/** The problem of a request that has found no way. */
export function noConnection() {
  return { code: 'no_connection', detail: '' };
}

function address() {
  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  return `${scheme}://${location.host}/api/v1/ws`;
}

/** What `early.js` has begun, for the first who asks: `{socket, asked, heard}`. */
function takeEarly() {
  const { early } = globalThis;
  delete globalThis.early;
  return early?.socket.readyState <= WebSocket.OPEN ? early : null;
}

export class Rpc {
  #socket = null;
  #calls = new Map();
  #nextId = 1;
  #tries = 0;
  #timer = null;
  #isWanted = true;
  #begun = null;

  /** `onOpen()`, `onEnd()`, `onTold(method, params, at)`, and `onHeard(at)` for anything that comes: when it did. */
  constructor(handlers) {
    this.handlers = handlers;
    this.#connect();
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Ends it for good. */
  close() {
    this.#isWanted = false;
    clearTimeout(this.#timer);
    this.#socket?.close();
  }

  /** Gives a connection up on which nothing comes any more, and makes another. */
  renew() {
    const given = this.#socket;
    this.#ended(given);
    given?.close();
  }

  /** Tries now rather than later. */
  hurry() {
    if (this.#socket === null && this.#isWanted) {
      this.#tries = 0;
      this.#connect();
    }
  }

  /** The answer; rejects with a problem. */
  call(method, params = {}, withinMs) {
    if (!this.isOpen) return Promise.reject(noConnection());
    const id = this.#nextId;
    this.#nextId += 1;
    const answer = this.#expect(id, withinMs);
    this.#socket.send(JSON.stringify({ jsonrpc: '2.0', id, method, params }));
    return answer;
  }

  #expect(id, withinMs = ANSWERS_WITHIN_MS) {
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => {
        this.#calls.delete(id);
        reject(noConnection());
      }, withinMs);
      this.#calls.set(id, { resolve, reject, timer });
    });
  }

  /** What was asked over this connection before this was there, once: `{params, answer, at}`, when that came, or null. */
  begun() {
    const begun = this.#begun;
    this.#begun = null;
    return begun;
  }

  #connect() {
    clearTimeout(this.#timer);
    const early = takeEarly();
    const socket = early?.socket ?? new WebSocket(address(), SUBPROTOCOL);
    this.#socket = socket;
    const tooLate = setTimeout(() => socket.readyState === WebSocket.CONNECTING && socket.close(), CONNECTS_WITHIN_MS);
    const opened = () => {
      if (socket !== this.#socket) return;
      clearTimeout(tooLate);
      this.#tries = 0;
      this.handlers.onHeard?.(performance.now());
      // Nothing comes before its answer.
      this.#begun = early && {
        params: early.asked.params,
        answer: this.#expect(early.asked.id),
        at: early.heard[0]?.at,
      };
      this.handlers.onOpen?.();
      if (early) this.#takeAll(early.heard);
    };
    if (socket.readyState === WebSocket.OPEN) queueMicrotask(opened);
    else socket.onopen = opened;
    socket.onmessage = ({ data }) => socket === this.#socket && this.#take(JSON.parse(data), performance.now());
    socket.onclose = () => {
      clearTimeout(tooLate);
      this.#ended(socket);
    };
  }

  /** Each in its turn, as they would come: who awaits an answer sees it before what came after it. */
  async #takeAll(heard) {
    for (const { data, at } of heard) {
      this.#take(JSON.parse(data), at);
      await null;
    }
  }

  #take(message, at) {
    this.handlers.onHeard?.(at);
    if (message.method !== undefined) {
      this.handlers.onTold?.(message.method, message.params, at);
      return;
    }
    const call = this.#calls.get(message.id);
    if (!call) return;
    this.#calls.delete(message.id);
    clearTimeout(call.timer);
    if (message.error) call.reject(message.error.data ?? { code: 'internal', detail: message.error.message });
    else call.resolve(message.result);
  }

  #ended(socket) {
    if (socket !== this.#socket) return;
    this.#socket = null;
    for (const { reject, timer } of this.#calls.values()) {
      clearTimeout(timer);
      reject(noConnection());
    }
    this.#calls.clear();
    this.handlers.onEnd?.();
    if (!this.#isWanted) return;
    this.#timer = setTimeout(() => this.#connect(), delay(this.#tries));
    this.#tries += 1;
  }
}
