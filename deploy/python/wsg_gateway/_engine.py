"""A thread with an event loop, which keeps connections and leases alive whatever the user's own thread does."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar("T")


class EngineClosed(RuntimeError):
    """The gateway was closed before."""


class Engine:
    """Runs coroutines in a thread of its own. The thread ends with the program."""

    def __init__(self) -> None:
        """Starts the thread."""
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="wsg-gateway", daemon=True)
        self._lock = threading.Lock()
        self._is_stopping = False
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        self.loop.run_forever()
        self.loop.close()

    def submit(self, coroutine: Coroutine[Any, Any, T]) -> Future[T]:
        """Starts a coroutine in the thread."""
        # What is submitted after the last coroutine would never run, and its caller would wait forever.
        with self._lock:
            if self._is_stopping:
                coroutine.close()
                raise EngineClosed("this gateway is closed: call connect again")
            return asyncio.run_coroutine_threadsafe(coroutine, self.loop)

    def wake(self, callback: Callable[[], None]) -> None:
        """Calls back in the thread soon, unless it ends. Nobody waits for that."""
        with self._lock:
            if not self._is_stopping:
                self.loop.call_soon_threadsafe(callback)

    def stop(self) -> None:
        """Ends the thread, after everybody who waits for it has an answer."""
        with self._lock:
            if self._is_stopping:
                return
            self._is_stopping = True
            drained = asyncio.run_coroutine_threadsafe(self._drain(), self.loop)
        drained.result()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(timeout=5)

    async def _drain(self) -> None:
        waiting = asyncio.all_tasks() - {asyncio.current_task()}
        if waiting:
            _, late = await asyncio.wait(waiting, timeout=1)
            for task in late:
                task.cancel()
            await asyncio.gather(*late, return_exceptions=True)
