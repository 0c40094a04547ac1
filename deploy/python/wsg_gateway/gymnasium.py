"""A gripper as an environment of Gymnasium: `pip install wsg-gateway[gymnasium]`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from ._errors import UnexpectedOutcome, ValueUnknown
from ._extra import needed_by
from ._sync import Control
from ._types import Motion

with needed_by("gymnasium"):
    import gymnasium
    import numpy as np
    from gymnasium.spaces import Box
    from numpy.typing import NDArray

Values = NDArray[np.float32]


def held(motion: Motion) -> float:
    """A reward: 1 if the motion ended with a held part, and 0 otherwise."""
    return float(motion.outcome == "PART_HELD")


class GripperEnv(gymnasium.Env[Values, Values]):
    """Moves a gripper that the program controls.

    An action has two numbers from 0 to 1. The first is a width as a share of the stroke. If the second is above 0.5, the
    gripper grips a part of this width, and otherwise it moves there. An observation is the width in mm, the force in N, and
    1 if a part is held. A step ends when its motion has ended. `info` has the outcome, and `newest` the motion with all values.

    An episode ends when a part is held. A refused motion, such as one after a FAST STOP, raises `Refused`, and a lost
    lease `ControlLost`. A motion with the outcome `UNKNOWN` raises `UnexpectedOutcome`: a person has to look at the gripper.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        control: Control,
        *,
        force_n: float,
        speed_mm_s: float = 50.0,
        open_mm: float | None = None,
        reward: Callable[[Motion], float] = held,
    ) -> None:
        """Moves under `control` at `speed_mm_s`. A reset opens the fingers to `open_mm`, by default to the whole stroke."""
        info = control.info()
        if info.stroke_mm is None or info.overdrive_force_n is None:
            raise ValueUnknown(f"the stroke of {control.name} is not known: connect the gateway to the gripper first")
        self._control, self._force_n, self._speed_mm_s, self._reward = control, force_n, speed_mm_s, reward
        self._open_mm = info.stroke_mm if open_mm is None else open_mm
        self._stroke_mm = info.stroke_mm
        self.newest: Motion | None = None
        """The newest motion."""
        self.action_space = Box(0, 1, (2,), np.float32)
        # The measured values can be beyond the limits, by noise and by the give of the fingers.
        largest = np.array([1.1 * info.stroke_mm, 2 * info.overdrive_force_n, 1], np.float32)
        self.observation_space = Box(-largest, largest)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Values, dict[str, Any]]:
        """Homes the gripper if needed, and opens the fingers. A held part falls."""
        super().reset(seed=seed)
        self._control.home(if_needed=True)
        return self._seen(self._control.release(self._open_mm, self._speed_mm_s).expect())

    def step(self, action: Values) -> tuple[Values, float, bool, bool, dict[str, Any]]:
        """Moves or grips, and waits for the end."""
        width_mm = float(action[0]) * self._stroke_mm
        if action[1] > 0.5:
            motion = self._control.grip(width_mm, self._speed_mm_s, self._force_n)
        elif self._control.holding:
            motion = self._control.release(width_mm, self._speed_mm_s)
        else:
            motion = self._control.move(width_mm, self._speed_mm_s)
        values, info = self._seen(motion)
        return values, self._reward(motion), motion.outcome == "PART_HELD", False, info

    def _seen(self, motion: Motion) -> tuple[Values, dict[str, Any]]:
        self.newest = motion
        if motion.outcome == "UNKNOWN":
            raise UnexpectedOutcome(motion)
        if motion.width_mm is None or motion.force_n is None:
            raise ValueUnknown(f"the width or the force of {motion.gripper} was not known when the motion ended")
        values = np.array([motion.width_mm, motion.force_n, motion.outcome == "PART_HELD"], np.float32)
        return values, {"outcome": motion.outcome}
