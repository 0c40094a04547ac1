"""Bounded queues between the connection and the user's iterators."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from typing import Generic, TypeVar

from ._errors import StreamEnded

T = TypeVar("T")
logger = logging.getLogger("wsg_gateway")


class Queue(Generic[T]):
    """The newest items for one reader. If the reader is slow, the oldest are dropped and counted."""

    def __init__(self, name: str, gripper: str | None, size: int) -> None:
        """Keeps up to `size` items, of one gripper or of all."""
        if size < 1:
            raise ValueError(f"size {size} is too small: an iterator keeps at least 1 item")
        self.name, self.gripper = name, gripper
        self._items: deque[T] = deque(maxlen=size)
        self._ready = asyncio.Event()
        self._is_closed = False
        self.dropped = 0

    def put(self, item: T) -> None:
        """Adds an item."""
        if len(self._items) == self._items.maxlen:
            self.drop(1, "the program reads them too slowly")
        self._items.append(item)
        self._ready.set()

    def drop(self, count: int, reason: str) -> None:
        """Counts missing items, and reports the first in the log, unless the reader wants the newest item only."""
        if self.dropped == 0 and self._items.maxlen != 1:
            logger.warning("%s: %d missing, because %s; `dropped` counts further ones", self.name, count, reason)
        self.dropped += count

    async def next(self, timeout_s: float | None = None) -> T:
        """Waits for an item. Raises `StreamEnded`, or `TimeoutError`."""
        while not self._items:
            if self._is_closed:
                raise StreamEnded(f"{self.name}: the iterator was closed")
            self._ready.clear()
            try:
                await asyncio.wait_for(self._ready.wait(), timeout_s)
            except asyncio.TimeoutError:
                raise TimeoutError(f"{self.name}: nothing new within {timeout_s:g} s") from None
        return self._items.popleft()

    async def close(self) -> None:
        """Ends the stream for its reader."""
        self._is_closed = True
        self._ready.set()
