"""Motions of goals, one at a time: the newest goal wins."""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from wsg_gateway import Control, GatewayError, Gripper, Motion

# Time between two looks at a goal that runs.
LOOK_S = 0.02


class Motions:
    """Carries out what goals and services ask for."""

    def __init__(self, gripper: Gripper, terms: dict[str, Any], keeps_control: bool, log: Callable[[str], None]) -> None:
        """Takes control of `gripper` by these terms: for each motion, or for good if `keeps_control`."""
        self._gripper, self._terms, self._keeps_control, self._log = gripper, terms, keeps_control, log
        self._turn, self._announcing = threading.Lock(), threading.Lock()
        self._threads = ThreadPoolExecutor(1, "motion")
        self._newest: object = None
        self._kept: Control | None = None
        self._is_in_control = False
        self.outcome = ""
        """Outcome of the newest motion, for people."""

    def announce(self, goal: object) -> None:
        """Lets the goal that runs give way to this one."""
        with self._announcing:
            self._newest = goal

    def announce_if_idle(self, token: object) -> bool:
        """Announces steering, unless a goal runs or waits for its turn. Returns whether it is announced."""
        with self._announcing:
            if self._newest is not None:
                return False
            self._newest = token
            return True

    @contextmanager
    def _finishing(self, goal: object) -> Iterator[None]:
        """Lets steering begin when this goal has ended, unless a newer one was announced."""
        try:
            yield
        finally:
            with self._announcing:
                if self._newest is goal:
                    self._newest = None

    @contextmanager
    def turn(self, token: object) -> Iterator[Control]:
        """Takes control for steering that was announced, once no goal runs any more.

        It does not wait for the lease: somebody could send a Stop meanwhile, which no session would notice.
        """
        with self._finishing(token), self._turn, self._control(timeout_s=0) as control:
            yield control

    def is_newest(self, goal: object) -> bool:
        """Whether no newer goal was announced."""
        return self._newest is goal

    def run(
        self, goal: object, move: Callable[[Control], Motion], is_cancelled: Callable[[], bool] = lambda: False
    ) -> Motion | None:
        """Moves, and returns the result.

        A goal that is cancelled or not the newest any more is stopped; `None` if it did not begin. Raises why the gateway
        refused it.
        """

        def is_over() -> bool:
            return is_cancelled() or not self.is_newest(goal)

        with self._finishing(goal), self._turn:
            motion = self._threads.submit(self._controlled, move, is_over)
            while not motion.done():
                # Before, a Stop would stop the fingers for another client.
                if self._is_in_control and is_over():
                    self._stop()
                concurrent.futures.wait([motion], LOOK_S)
            try:
                ended = motion.result()
            except Exception as error:
                self.outcome = str(error)
                raise
            if ended is None:
                self.outcome = "not begun: a newer goal came first, or it was cancelled"
                return None
            self.outcome = f"{ended.kind}: {ended.outcome}" + (f", {ended.detail}" if ended.detail else "")
            return ended

    def _controlled(self, move: Callable[[Control], Motion], is_over: Callable[[], bool]) -> Motion | None:
        with self._control() as control:
            if is_over():
                return None
            self._is_in_control = True
            try:
                return move(control)
            finally:
                self._is_in_control = False

    @contextmanager
    def _control(self, **changed: Any) -> Iterator[Control]:
        terms = self._terms | changed
        if not self._keeps_control:
            with self._gripper.control(**terms) as control:
                yield control
            return
        if self._kept is None or not self._kept.held:
            self._kept = self._gripper.control(**terms).__enter__()
        yield self._kept

    def _stop(self) -> None:
        try:
            self._gripper.stop()
        except GatewayError as error:
            self._log(f"the Stop failed: {error}")
