"""A gripper as an environment of `openpi-client`: `pip install wsg-gateway[openpi]`."""

from __future__ import annotations

from typing import Any

from ._background import Background
from ._errors import ValueUnknown
from ._extra import needed_by
from ._sync import Control

with needed_by("openpi"):
    import numpy as np
    from openpi_client.runtime.environment import Environment


class GripperEnvironment(Environment):
    """Opens and closes a gripper that the program controls, as policies of openpi do: 0 is open, and 1 is closed.

    The last value of `actions` is the gripper's. Policies repeat it many times a second, so that a motion starts only when
    it passes 0.5, and runs while the arm goes on. Closed fingers keep pushing: with the force limit in firmware 2, and with
    half of the nominal force in firmware 4.
    """

    def __init__(
        self, control: Control, *, open_mm: float, closed_mm: float = 0.0, speed_mm_s: float = 100.0, episode_steps: int = 0
    ) -> None:
        """Moves under `control`. An episode ends after `episode_steps`, or never if that is 0."""
        self._control, self._motions = control, Background(control)
        self._open_mm, self._closed_mm, self._speed_mm_s = open_mm, closed_mm, speed_mm_s
        self._episode_steps, self._steps = episode_steps, 0
        self._is_closed = False

    def reset(self) -> None:
        """Homes the gripper if needed, and opens the fingers. A held part falls."""
        self._control.home(if_needed=True)
        self._motions.start(lambda: self._control.move(self._open_mm, self._speed_mm_s)).result().expect()
        self._is_closed, self._steps = False, 0

    def is_episode_complete(self) -> bool:
        """Whether the episode has had its steps."""
        return 0 < self._episode_steps <= self._steps

    def get_observation(self) -> dict[str, Any]:
        """The newest pushed width as `observation/gripper_position`, from 0 (open) to 1 (closed). Raises `ValueUnknown`."""
        width_mm = self._control.width_mm
        if width_mm is None:
            raise ValueUnknown(f"the width of {self._control.name} is not known: home it first")
        position = (self._open_mm - width_mm) / (self._open_mm - self._closed_mm)
        return {"observation/gripper_position": np.array([np.clip(position, 0, 1)], np.float32)}

    def apply_action(self, action: dict[str, Any]) -> None:
        """Opens or closes the gripper if the action has changed. Raises why the motion before failed.

        Raises `Refused` if it was refused, such as after a FAST STOP, and `ControlLost`.
        """
        self._steps += 1
        self._motions.newest()
        is_closed = float(action["actions"][-1]) > 0.5
        if is_closed != self._is_closed:
            width_mm = self._closed_mm if is_closed else self._open_mm
            self._motions.start(lambda: self._control.move(width_mm, self._speed_mm_s, on_block="clamp"))
            self._is_closed = is_closed
