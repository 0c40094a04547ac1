"""Reads of the newest pushed values. They send no request, and are safe in any thread."""

from __future__ import annotations

import time
from datetime import datetime
from typing import TypeVar

from ._core import Core
from ._errors import ValueUnknown
from ._types import Link, State

T = TypeVar("T")


class Reads:
    """The newest state of a gripper, as the gateway has pushed it.

    A value that is not known, or older than `stale_after_s` of `connect`, is `None`, or raises `ValueUnknown` after
    `connect(..., unknown="raise")`.
    """

    def __init__(self, core: Core, name: str, is_strict: bool, stale_after_s: float) -> None:
        """Reads the states of the gripper `name`."""
        self.name = name
        """Name of the gripper."""
        self._core, self._is_strict, self._stale_after_s = core, is_strict, stale_after_s

    def _newest(self) -> State | None:
        """The newest state, if it came lately."""
        newest = self._core.latest.get(self.name)
        if newest is None or time.monotonic() - newest[1] > self._stale_after_s:
            return None
        return newest[0]

    def _measured(self) -> State | None:
        """The newest state, if the values in it are new enough."""
        newest = self._core.latest.get(self.name)
        if newest is None or (age_ms := newest[0].age_ms) is None:
            return None
        return newest[0] if time.monotonic() - newest[1] + age_ms / 1000 <= self._stale_after_s else None

    def _known(self, name: str, value: T | None) -> T | None:
        if value is None and self._is_strict:
            raise ValueUnknown(f"{name} of {self.name} is not known at present: check `link` and `age`")
        return value

    @property
    def state(self) -> State | None:
        """All values of the newest state."""
        return self._known("the state", self._newest())

    @property
    def width_mm(self) -> float | None:
        """Opening width in mm. Not known until the gripper is referenced."""
        state = self._measured()
        return self._known("width_mm", state.width_mm if state else None)

    @property
    def speed_mm_s(self) -> float | None:
        """Speed of the fingers relative to each other, in mm/s."""
        state = self._measured()
        return self._known("speed_mm_s", state.speed_mm_s if state else None)

    @property
    def force_n(self) -> float | None:
        """Gripping force in N."""
        state = self._measured()
        return self._known("force_n", state.force_n if state else None)

    @property
    def moving(self) -> bool | None:
        """Whether the fingers move."""
        state = self._measured()
        return self._known("moving", state.moving if state else None)

    @property
    def referenced(self) -> bool | None:
        """Whether the gripper knows its position. If not, home it."""
        state = self._measured()
        return self._known("referenced", state.referenced if state else None)

    @property
    def holding(self) -> bool | None:
        """Whether a part is held."""
        state = self._measured()
        return self._known("holding", state.state == "HOLDING" if state and state.state is not None else None)

    @property
    def fast_stop_latched(self) -> bool | None:
        """Whether a FAST STOP is latched. Treat `None` as a FAST STOP."""
        state = self._newest()
        return self._known("fast_stop_latched", state.fast_stop if state else None)

    @property
    def link(self) -> Link | None:
        """Connection of the gateway to the gripper. Values can be trusted if it is `connected`."""
        state = self._newest()
        return self._known("link", state.link if state else None)

    @property
    def measured_at(self) -> datetime | None:
        """Time at which the newest known value arrived at the gateway, by the gateway's clock, in UTC."""
        state = self._measured()
        return self._known("measured_at", state.measured_at if state else None)

    @property
    def age(self) -> float | None:
        """Age in s of the oldest value in the newest state: the others are younger.

        It contains the gateway's own age of the value, and the time since the state arrived, but not the time on the
        network. While nothing changes, the gateway repeats the state once a second, and the age grows until then.
        """
        newest = self._core.latest.get(self.name)
        if newest is None or newest[0].age_ms is None:
            return self._known("age", None)
        return newest[0].age_ms / 1000 + time.monotonic() - newest[1]
