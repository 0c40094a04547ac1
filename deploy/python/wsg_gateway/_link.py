"""A WebSocket to the gateway that connects again by itself."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import random
import ssl
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Subprotocol

from ._address import Address, refusal
from ._errors import ConnectionLost, Refused, Unreachable

logger = logging.getLogger("wsg_gateway")

# The gateway pings every second, and gives up a client after 3 s. The client does the same.
PING_S, PONG_S = 1.0, 3.0
ANSWER_S = 10.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.05, 1.0
LARGEST_MESSAGE = 16 * 2**20
# Time between two looks at a network that is slow.
TAKEN_S = 0.005

Notify = Callable[[str, dict[str, Any]], None]


class Link:
    """One connection. A call fails at once while it is down; nothing is repeated."""

    def __init__(
        self,
        address: Address,
        context: ssl.SSLContext | None,
        notify: Notify | None = None,
        opened: Callable[[], Awaitable[None]] | None = None,
        closed: Callable[[str], None] | None = None,
    ) -> None:
        """Prepares the connection. `opened` is awaited before the link counts as up."""
        self._address, self._context = address, context
        self._notify, self._opened, self._closed = notify, opened, closed
        self._ids = itertools.count(1)
        self._pending: dict[int, asyncio.Future[Any]] = {}
        self._socket: ClientConnection | None = None
        self._changed = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._is_stopped = False
        self.is_up = False
        self.generation = 0
        """Number of connections so far."""
        self.error: Exception = Unreachable("not connected yet")

    def start(self) -> None:
        """Connects, and connects again whenever the connection ends."""
        self._task = asyncio.create_task(self._run())

    async def stop(self) -> None:
        """Closes the connection for good."""
        self._is_stopped = True
        self._changed.set()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def up(self, timeout_s: float, is_final: Callable[[Exception], bool] = lambda _: False) -> None:
        """Waits until the connection is open. Raises the last error after the timeout, or at once if it is final."""
        deadline = asyncio.get_running_loop().time() + timeout_s
        while not self.is_up:
            self._changed.clear()
            remaining = deadline - asyncio.get_running_loop().time()
            if self._is_stopped:
                raise Unreachable("the gateway was closed")
            if is_final(self.error):
                raise self.error
            try:
                await asyncio.wait_for(self._changed.wait(), max(remaining, 0))
            except asyncio.TimeoutError:
                if isinstance(self.error, Refused):
                    raise self.error from None
                raise Unreachable(f"no connection to {self._address.url} within {timeout_s:g} s: {self.error}") from None

    async def call(self, method: str, timeout_s: float = ANSWER_S, /, **params: Any) -> Any:
        """Sends a request, and returns its result. Raises `Refused`, `Unreachable` or `ConnectionLost`."""
        socket = self._socket
        if socket is None:
            raise Unreachable(f"no connection to {self._address.url}: {self.error}")
        number = next(self._ids)
        answer = self._pending[number] = asyncio.get_running_loop().create_future()
        sent = {key: value for key, value in params.items() if value is not None}
        try:
            await socket.send(json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": sent}))
            message = await asyncio.wait_for(answer, timeout_s)
        except ConnectionClosed as error:
            raise ConnectionLost(f"the connection ended during {method}: {error}") from error
        except asyncio.TimeoutError:
            # The gateway is lost if it does not answer. Its own end of the connection then ends the lease.
            if timeout_s >= ANSWER_S:
                socket.transport.abort()
            raise ConnectionLost(f"the gateway did not answer {method} within {timeout_s:g} s") from None
        finally:
            del self._pending[number]
        if "error" in message:
            raise Refused(message["error"].get("data") or {"detail": message["error"].get("message", "")})
        return message["result"]

    async def notify(self, method: str, /, **params: Any) -> None:
        """Sends a request that gets no answer. Waits until the network has taken what was sent before."""
        if (socket := self._socket) is None:
            raise Unreachable(f"no connection to {self._address.url}: {self.error}")
        sent = {key: value for key, value in params.items() if value is not None}
        try:
            await socket.send(json.dumps({"jsonrpc": "2.0", "method": method, "params": sent}))
            while socket.transport.get_write_buffer_size() > 0:
                await asyncio.sleep(TAKEN_S)
        except ConnectionClosed as error:
            raise ConnectionLost(f"the connection ended during {method}: {error}") from error

    async def _run(self) -> None:
        pause = FIRST_PAUSE_S
        while True:
            generation = self.generation
            try:
                await self._connected()
            except Exception as error:
                # The connection is opened again after any error: leases and FAST STOPs depend on it.
                self.error = self._told(error)
            self._changed.set()
            pause = FIRST_PAUSE_S if self.generation > generation else min(2 * pause, LONGEST_PAUSE_S)
            await asyncio.sleep(pause * random.uniform(0.75, 1.25))

    async def _connected(self) -> None:
        """Serves one connection until it ends."""
        # `proxy=None`: a proxy that a variable of the environment names must not be used for a gripper.
        async with connect(
            self._address.websocket,
            subprotocols=[Subprotocol("wsg.v1")],
            additional_headers=self._address.headers,
            ssl=self._context,
            proxy=None,
            compression=None,
            open_timeout=5,
            close_timeout=1,
            ping_interval=PING_S,
            ping_timeout=PONG_S,
            max_size=LARGEST_MESSAGE,
        ) as socket:
            reader = asyncio.create_task(self._read(socket))
            self._socket = socket
            try:
                if self._opened is not None:
                    await self._opened()
                self.is_up = True
                self.generation += 1
                self._changed.set()
                await asyncio.shield(reader)
            finally:
                self.is_up, self._socket = False, None
                reader.cancel()
                if self._closed is not None:
                    self._closed("the connection to the gateway ended")

    async def _read(self, socket: ClientConnection) -> None:
        try:
            async for text in socket:
                message = json.loads(text)
                pending = self._pending.get(message.get("id"))
                if pending is not None and not pending.done():
                    pending.set_result(message)
                elif "method" in message and self._notify is not None:
                    self._tell(message["method"], message.get("params") or {})
            raise ConnectionLost(f"the gateway closed the connection ({socket.close_code} {socket.close_reason})")
        finally:
            self._fail_pending()

    def _tell(self, method: str, params: dict[str, Any]) -> None:
        assert self._notify is not None
        try:
            self._notify(method, params)
        except Exception:
            logger.exception("the notification %s of the gateway is not understood, and ignored", method)

    def _fail_pending(self) -> None:
        for pending in self._pending.values():
            if not pending.done():
                pending.set_exception(ConnectionLost("the connection to the gateway ended before its response"))

    def _told(self, error: Exception) -> Exception:
        """Names the refusal of a handshake."""
        if isinstance(error, InvalidStatus):
            return refusal(bytes(error.response.body or b""), error.response.status_code)
        if isinstance(error, (Refused, Unreachable)):
            return error
        return Unreachable(f"{type(error).__name__}: {error}")
