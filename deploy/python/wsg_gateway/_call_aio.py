"""How the asyncio module runs coroutines in the thread of the engine."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import Callable, Coroutine, Generator
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from ._engine import Engine, EngineClosed
from ._errors import StreamEnded
from ._stream import Queue

T = TypeVar("T")
logger = logging.getLogger("wsg_gateway")
followers: set[asyncio.Task[None]] = set()


class Openable(Protocol):
    """Something that is opened and closed."""

    async def open(self) -> Any:
        """Opens it."""

    async def close(self) -> None:
        """Closes it."""


O = TypeVar("O", bound=Openable)  # noqa: E741


async def call(engine: Engine, coroutine: Coroutine[Any, Any, T]) -> T:
    """Runs a coroutine in the engine. Cancelling the caller cancels the coroutine."""
    return await asyncio.wrap_future(engine.submit(coroutine))


def follow(engine: Engine, queue: Queue[T], callback: Callable[[T], Any]) -> None:
    """Calls back for each item, in a task of the user's loop. Awaits the callback if it is a coroutine."""

    async def run() -> None:
        while True:
            try:
                item = await call(engine, queue.next())
            except (StreamEnded, EngineClosed):
                return
            try:
                result = callback(item)
                if inspect.isawaitable(result):
                    await result
            except Exception:
                logger.exception("%s: the callback failed", queue.name)

    task = asyncio.get_running_loop().create_task(run())
    followers.add(task)
    task.add_done_callback(followers.discard)


class Opening(Generic[O]):
    """Opens something by `await`, or for a block by `async with`."""

    def __init__(self, inner: O) -> None:
        """Keeps what to open."""
        self._inner = inner

    def __await__(self) -> Generator[Any, None, O]:
        """Opens it. The caller has to close it."""
        return self.__aenter__().__await__()

    async def __aenter__(self) -> O:
        """Opens it."""
        await self._inner.open()
        return self._inner

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Closes it."""
        await self._inner.close()


def opened(inner: O) -> Opening[O]:
    """Returns what opens it."""
    return Opening(inner)
