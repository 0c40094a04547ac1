"""Motions of the extras that run while the program goes on."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from ._sync import Control
from ._types import Motion

STOP_S = 0.5


class Background:
    """Runs the motions of one gripper in a thread, one at a time. A new motion stops the one before."""

    def __init__(self, control: Control) -> None:
        """Moves under `control`, which has to be held meanwhile."""
        self.control = control
        self._threads = ThreadPoolExecutor(1, "wsg-motion")
        self._newest: Future[Motion] | None = None

    def start(self, motion: Callable[[], Motion]) -> Future[Motion]:
        """Starts a motion, such as `lambda: control.move(20)`. Its errors are in the result."""
        while self._newest is not None and not self._newest.done():
            # A Stop that comes before its motion stops nothing.
            self.control.stop()
            concurrent.futures.wait([self._newest], STOP_S)
        self._newest = self._threads.submit(motion)
        return self._newest

    def newest(self) -> Motion | None:
        """Returns the newest motion if it has ended, or raises its error."""
        return self._newest.result() if self._newest is not None and self._newest.done() else None
