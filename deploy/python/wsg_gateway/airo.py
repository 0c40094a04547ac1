"""A gripper for `airo-robots`: `pip install wsg-gateway[airo]`. All values are in meters, meters per second and Newton."""

from __future__ import annotations

from ._background import Background
from ._errors import ValueUnknown
from ._extra import needed_by
from ._sync import Control

with needed_by("airo"):
    from airo_robots.awaitable_action import AwaitableAction
    from airo_robots.grippers.parallel_position_gripper import ParallelPositionGripper, ParallelPositionGripperSpecs


class WsgGripper(ParallelPositionGripper):
    """Moves a gripper that the program controls.

    This interface does not know the width of parts, so fingers that meet a part keep pushing: with `max_grasp_force` in
    firmware 2, and with half of the nominal force in firmware 4. `control.grip` knows the width. It keeps to the force in
    each firmware, and notices a lost part.
    """

    def __init__(self, control: Control, *, speed: float = 0.05, max_grasp_force: float | None = None) -> None:
        """Moves under `control`. Without `max_grasp_force`, the gripper keeps the force that it has."""
        info = control.info()
        values = (info.stroke_mm, info.nominal_force_n, info.min_force_n, info.max_speed_mm_s, info.min_speed_mm_s)
        if None in values:
            raise ValueUnknown(f"the limits of {control.name} are not known: connect the gateway to the gripper first")
        stroke, largest_force, smallest_force, largest_speed, smallest_speed = (float(value or 0) for value in values)
        specs = ParallelPositionGripperSpecs(
            stroke / 1000, 0.0, largest_force, smallest_force, largest_speed / 1000, smallest_speed / 1000
        )
        super().__init__(specs)
        self._control, self._motions, self._speed = control, Background(control), speed
        if max_grasp_force is not None:
            self.max_grasp_force = max_grasp_force

    @property
    def speed(self) -> float:
        """Speed of the next motions in m/s."""
        return self._speed

    @speed.setter
    def speed(self, new_speed: float) -> None:
        self._speed = new_speed

    @property
    def max_grasp_force(self) -> float:
        """Limit of the force in N, read from the gateway."""
        return float(self._control._request("settings.force-limit")["force_n"])

    @max_grasp_force.setter
    def max_grasp_force(self, new_force: float) -> None:
        self._control.command("settings.force-limit.set", force_n=new_force)

    def get_current_width(self) -> float:
        """The newest pushed width in m. Raises `ValueUnknown`."""
        width_mm = self._control.width_mm
        if width_mm is None:
            raise ValueUnknown(f"the width of {self._control.name} is not known: home it first")
        return width_mm / 1000

    def move(self, width: float, speed: float | None = None, force: float | None = None) -> AwaitableAction:
        """Starts a motion to a width in m. `wait` returns when it has ended, or raises why it did not start.

        A motion that still runs is stopped first. A speed or a force is kept for the next motions.
        """
        if speed is not None:
            self.speed = speed
        if force is not None:
            self.max_grasp_force = force
        speed_mm_s = 1000 * self._speed
        motion = self._motions.start(lambda: self._control.move(1000 * width, speed_mm_s, on_block="clamp"))
        return AwaitableAction(lambda: motion.done() and motion.result() is not None, default_sleep_resolution=0.01)

    def is_an_object_grasped(self) -> bool:
        """Whether a part stopped the newest motion, or a grip of `control` holds one."""
        newest = self._motions.newest()
        return bool(self._control.holding) or (newest is not None and newest.outcome == "BLOCKED")
