#!/usr/bin/env python3
"""Mirrors ROS 2's control_msgs/action/GripperCommand: what the action server of a ROS 2 node has to do.

Goal: `position`, the opening in m, and `max_effort` in N. Feedback and result: `position`, `effort`, `stalled`,
`reached_goal`. Without ROS: the node's action server calls `execute`, and passes its feedback on.

    gripper_command.py 0.020 30.0
"""

import argparse
import dataclasses
import json
import math

from watch_and_grip import Gripper, connect

# Speed of a goal without one.
SPEED_MM_S = 100.0


@dataclasses.dataclass
class Result:
    """Result and feedback of GripperCommand. An unknown value is NaN, as in ROS."""

    position: float
    effort: float
    stalled: bool
    reached_goal: bool

    @classmethod
    def of(cls, report):
        """Returns the result of an ended command or of telemetry. Null there means unknown."""
        width_mm, force_n = report["width_mm"], report["force_n"]
        position = math.nan if width_mm is None else width_mm / 1000
        effort = math.nan if force_n is None else force_n
        return cls(position, effort, bool(report.get("stalled")), bool(report.get("reached_goal")))


class GripperCommand:
    """An action server's inside, for one gripper."""

    def __init__(self, session, gateway, name, client):
        self.gripper = Gripper(session, gateway, name, client)
        self.session = session
        self.gripper.take_lease()
        if not self.gripper.query("state")["referenced"]:
            self.gripper.command("home")

    def execute(self, position, max_effort, feedback=lambda _: None):
        """Runs a goal to its end. To close is to grip a part, to open is to move."""

        def tell(sample):
            feedback(Result.of(json.loads(sample.payload.to_string())))

        with self.session.declare_subscriber(f"{self.gripper.key}/telemetry", tell):
            width_mm, now_mm = position * 1000, self.gripper.query("state")["width_mm"]
            is_closing = now_mm is None or width_mm < now_mm
            if is_closing and max_effort > 0:
                done = self.gripper.command("grip", width_mm=width_mm, speed_mm_s=SPEED_MM_S, force_n=max_effort)
            else:
                done = self.gripper.command("move", width_mm=width_mm, speed_mm_s=SPEED_MM_S)
        return Result.of(done)

    def cancel(self):
        """A goal is cancelled by a Stop."""
        self.gripper.command("stop")

    def close(self):
        self.gripper.release_lease()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("position", type=float, help="m")
    parser.add_argument("max_effort", type=float, help="N")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT")
    parser.add_argument("--gateway", default="gateway")
    parser.add_argument("--gripper", default="left")
    given = parser.parse_args()
    with connect(given.connect) as session:
        action = GripperCommand(session, given.gateway, given.gripper, "gripper-command")
        result = dataclasses.asdict(action.execute(given.position, given.max_effort))
        # JSON has no NaN.
        print(json.dumps({name: None if value != value else value for name, value in result.items()}))
        action.close()


if __name__ == "__main__":
    main()
