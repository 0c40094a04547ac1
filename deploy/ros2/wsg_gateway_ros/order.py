"""What a goal asks for, and what its result says. Widths are in mm and positions in m."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wsg_gateway import Control, Motion, State


@dataclass(frozen=True)
class Order:
    """A motion that a goal asks for."""

    width_mm: float
    speed_mm_s: float
    force_n: float | None
    """Force limit; `None` leaves that of the gripper."""
    clamps: bool
    """Whether fingers that close push against whatever they meet, rather than grip a part of this width."""

    def carry_out(self, control: Control) -> Motion:
        """Moves once, and returns the result when it is known."""
        now_mm = control.width_mm
        is_closing = now_mm is None or self.width_mm < now_mm
        if not is_closing:
            return (control.release if control.holding else control.move)(self.width_mm, self.speed_mm_s)
        if not self.clamps and self.force_n is not None:
            return control.grip(self.width_mm, self.speed_mm_s, self.force_n)
        if self.clamps and self.force_n is not None:
            control.command("settings.force-limit.set", force_n=self.force_n)
        return control.move(self.width_mm, self.speed_mm_s, on_block="clamp" if self.clamps else "stop")

    def is_reached(self, motion: Motion) -> bool:
        """Whether the goal has succeeded. Fingers that should push have succeeded when something stopped them."""
        return motion.ok or (self.clamps and motion.outcome == "BLOCKED")


@dataclass(frozen=True)
class Values:
    """Values of a result or a feedback. A value that is not known is NaN, as in ROS."""

    width_mm: float
    speed_mm_s: float
    force_n: float
    stalled: bool
    reached_goal: bool

    @classmethod
    def of(cls, found: Motion | State | None) -> Values:
        """The values of a motion that has ended, or of a state."""
        if found is None:
            return cls(math.nan, math.nan, math.nan, False, False)
        stalled = bool(getattr(found, "stalled", False))
        reached_goal = bool(getattr(found, "reached_goal", False))
        speed = 0.0 if isinstance(found, Motion) else number(found.speed_mm_s)
        return cls(number(found.width_mm), speed, number(found.force_n), stalled, reached_goal)


def number(value: float | None) -> float:
    return math.nan if value is None else float(value)
