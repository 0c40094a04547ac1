// JSON-RPC 2.0 over one WebSocket, which reconnects whenever it ends.

import { delay } from '../core/backoff.js';

const SUBPROTOCOL = 'wsg.v1';

/** Time limit of a connection attempt; then another one follows. */
const CONNECTS_WITHIN_MS = 3000;

/** Time limit of an answer, including the time-out of a slow device at 9600 baud. */
const ANSWERS_WITHIN_MS = 8000;

/** Problem of a request that got no answer. */
export function noConnection() {
  return { code: 'no_connection', detail: '' };
}

/** Address relative to the page, which a proxy can serve below any path. `ws:` takes the place of `http:`. */
function address() {
  const relative = new URL('api/v1/ws', location.href);
  relative.protocol = relative.protocol.replace('http', 'ws');
  return relative;
}

/** Returns the connection begun by `early.js`, once: `{socket, asked, heard}`, or null. */
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
  #wasOpen = false;
  /** Called with the number of attempts to connect that have failed in a row. */
  onFailed = null;

  /**
   * `onOpen()`, `onEnd()`, `onNotification(method, params, at)`, and `onHeard(at)` for every message. `label()` returns
   * the user's name, which is sent with each request.
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.#connect();
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Closes the connection until `open` is called. */
  close() {
    if (!this.#isWanted) return;
    this.#isWanted = false;
    clearTimeout(this.#timer);
    const given = this.#socket;
    if (given === null) return;
    this.#ended(given);
    given.close();
  }

  /** Opens a closed connection again. */
  open() {
    if (this.#isWanted) return;
    this.#isWanted = true;
    this.hurry();
  }

  /** Whether the page wants a connection. */
  get isWanted() {
    return this.#isWanted;
  }

  /** Replaces a silent connection. */
  renew() {
    const given = this.#socket;
    this.#ended(given);
    given?.close();
  }

  /** Reconnects at once instead of after the delay. */
  hurry() {
    if (this.#socket === null && this.#isWanted) {
      this.#tries = 0;
      this.#connect();
    }
  }

  /** Resolves with the answer, or rejects with a problem. */
  call(method, params = {}, withinMs) {
    if (!this.isOpen) return Promise.reject(noConnection());
    const id = this.#nextId;
    this.#nextId += 1;
    const answer = this.#expect(id, withinMs);
    this.#socket.send(JSON.stringify({ jsonrpc: '2.0', id, method, params, client: this.handlers.label?.() }));
    return answer;
  }

  /** Sends a request that gets no answer. */
  notify(method, params) {
    if (this.isOpen)
      this.#socket.send(JSON.stringify({ jsonrpc: '2.0', method, params, client: this.handlers.label?.() }));
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

  /** Returns the request of `early.js` on this connection, once: `{params, answer, at}`, or null. */
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
      this.#wasOpen = true;
      // The first message is its answer.
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

  /** Delivers early messages in separate turns, so that code awaiting an answer runs before the messages after it. */
  async #takeAll(heard) {
    for (const { data, at } of heard) {
      this.#take(JSON.parse(data), at);
      await null;
    }
  }

  #take(message, at) {
    this.handlers.onHeard?.(at);
    if (message.method !== undefined) {
      this.handlers.onNotification?.(message.method, message.params, at);
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
    const wasOpen = this.#wasOpen;
    this.#wasOpen = false;
    this.handlers.onEnd?.();
    if (!this.#isWanted) return;
    this.#timer = setTimeout(() => this.#connect(), delay(this.#tries));
    this.#tries += 1;
    if (!wasOpen) this.onFailed?.(this.#tries);
  }
}
