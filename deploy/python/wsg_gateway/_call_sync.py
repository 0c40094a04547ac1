"""How the synchronous module runs coroutines in the thread of the engine."""

from __future__ import annotations

import concurrent.futures
import logging
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Protocol, TypeVar

from ._engine import Engine, EngineClosed
from ._errors import StreamEnded
from ._stream import Queue

T = TypeVar("T")
logger = logging.getLogger("wsg_gateway")


class Openable(Protocol):
    """Something that is opened."""

    def open(self) -> Any:
        """Opens it."""


O = TypeVar("O", bound=Openable)  # noqa: E741


def call(engine: Engine, coroutine: Coroutine[Any, Any, T]) -> T:
    """Runs a coroutine in the engine. Ctrl-C ends the wait, and cancels the coroutine."""
    future = engine.submit(coroutine)
    try:
        # On Windows, only a wait with a timeout notices Ctrl-C.
        while not future.done():
            concurrent.futures.wait([future], timeout=1)
        return future.result()
    except BaseException:
        future.cancel()
        raise


def follow(engine: Engine, queue: Queue[T], callback: Callable[[T], Any]) -> None:
    """Calls back for each item, in a thread of its own."""

    def run() -> None:
        while True:
            try:
                item = call(engine, queue.next())
            except (StreamEnded, EngineClosed, concurrent.futures.CancelledError):
                return
            try:
                callback(item)
            except Exception:
                logger.exception("%s: the callback failed", queue.name)

    threading.Thread(target=run, name=queue.name, daemon=True).start()


def opened(inner: O) -> O:
    """Opens it."""
    inner.open()
    return inner
