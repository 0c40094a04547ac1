"""Node for one gripper: actions, steering, joint states, diagnostics and services. `deploy/guide/ros2.md` explains it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
import wsg_gateway
from control_msgs.action import GripperCommand, ParallelGripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy._rclpy_pybind11 import RCLError
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from .health import status
from .motions import Motions
from .order import Order, Values
from .steering import Steering

# Parameters with their defaults.
PARAMETERS: dict[str, Any] = {
    "url": "http://127.0.0.1:8080",
    "gripper": "left",
    "token_file": "",
    "ca_file": "",
    "joint": "finger_left_joint",
    "max_hz": 50,
    "speed": 0.1,
    "min_width": 0.0,
    "max_width": 0.0,
    "max_force": 0.0,
    "open_width": 0.0,
    "gripper_command_position": "gap",
    "closing": "grip",
    "keep_control": False,
    "control_timeout": 5.0,
    "on_loss_moving": "fast_stop",
    "on_loss_holding": "keep",
    "steering": False,
    "steering_timeout": 0.2,
    "steering_force": 0.0,
}
CLOCK_S = 60.0
THREADS = 8
# A target that is lost is not sent again: the next one is newer. Publishers of any reliability fit.
TARGETS = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class GripperNode(Node):
    """Serves one gripper of a gateway."""

    def __init__(self, **arguments: Any) -> None:
        """Reads the parameters. Raises `ValueError` for a wrong one."""
        super().__init__("wsg", **arguments)
        for name, default in PARAMETERS.items():
            # A number without a point, such as `speed:=1`, is a whole number for ROS.
            self.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=isinstance(default, float)))
        self._check("gripper_command_position", "gap", "joint")
        self._check("closing", "grip", "clamp")
        self._shown_fast_stop: str | None = None
        self._offset_s, self._offset_at = 0.0, float("-inf")
        self._feedback: Callable[[wsg_gateway.State], None] | None = None
        self._gateway: wsg_gateway.Gateway | None = None

    def connect(self) -> None:
        """Connects to the gateway, and serves the gripper. Raises `GatewayError`, and `KeyError` for a wrong name."""
        token_file, ca_file = self._value("token_file"), self._value("ca_file")
        self._gateway = gateway = wsg_gateway.connect(
            self._value("url"),
            token=Path(token_file).read_text().strip() if token_file else None,
            tls=ca_file or None,
            max_hz=self._value("max_hz"),
        )
        self._gripper = gateway[self._value("gripper")]
        terms = {"holder": self.get_fully_qualified_name(), "timeout_s": self._value("control_timeout")}
        terms |= {name: self._value(name) for name in ("on_loss_moving", "on_loss_holding")}
        self._motions = Motions(self._gripper, terms, self._value("keep_control"), self._warn)
        self._info = self._gripper.info()
        self._serve()
        self._gripper.telemetry(64).follow(self._stated)

    def _serve(self) -> None:
        """Creates publishers, actions and services. They run beside each other, so that a FAST STOP waits for nothing."""
        self._joints = self.create_publisher(JointState, "joint_states", 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.create_timer(1.0, self._diagnose, ReentrantCallbackGroup())
        group = ReentrantCallbackGroup()
        self._actions = [
            ActionServer(
                self,
                kind,
                name,
                execute_callback=execute,
                goal_callback=accept,
                handle_accepted_callback=self._accepted,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=group,
            )
            for kind, name, accept, execute in [
                (GripperCommand, "~/gripper_cmd", self._accept_gap, self._execute_gap),
                (ParallelGripperCommand, "~/parallel_gripper_cmd", self._accept_joint, self._execute_joint),
            ]
        ]
        for name, call in {
            "home": self._home,
            "release": self._release,
            "fast_stop": self._fast_stop,
            "acknowledge": self._acknowledge,
        }.items():
            self.create_service(Trigger, f"~/{name}", self._service(name, call), callback_group=ReentrantCallbackGroup())
        if self._value("steering"):
            self._serve_steering()

    def _serve_steering(self) -> None:
        terms = {"max_speed_mm_s": self._value("speed") * 1000, "timeout_ms": round(self._value("steering_timeout") * 1000)}
        steering = Steering(self._motions, terms | {"force_n": self._value("steering_force") or None}, self._inform)

        def steer(message: Float64MultiArray) -> None:
            try:
                steering.target(self._width_mm(message.data))
            except ValueError as error:
                steering.ignored()
                self.get_logger().warning(f"target ignored: {error}", throttle_duration_sec=1.0)

        group = MutuallyExclusiveCallbackGroup()
        self.create_subscription(Float64MultiArray, "~/commands", steer, TARGETS, callback_group=group)

    # Values that are pushed.

    def _stated(self, state: wsg_gateway.State) -> None:
        """Publishes the joint with the time of its measurement, and the feedback of a goal that runs."""
        if not self.context.ok():
            return
        if (feedback := self._feedback) is not None:
            feedback(state)
        if state.width_mm is None or state.measured_at is None:
            return  # Diagnostics says so.
        self._measure_clock()
        message = self._joint(Values.of(state))
        message.header.stamp = Time(nanoseconds=int((state.measured_at.timestamp() - self._offset_s) * 1e9)).to_msg()
        self._joints.publish(message)

    def _joint(self, values: Values) -> JointState:
        """The joint of one finger, which moves by half of the width."""
        message = JointState(name=[self._value("joint")], position=[values.width_mm / 2000], velocity=[values.speed_mm_s / 2000])
        message.effort = [values.force_n]
        return message

    def _measure_clock(self) -> None:
        """Measures the difference to the gateway's clock now and then."""
        if time.monotonic() - self._offset_at < CLOCK_S:
            return
        self._offset_at = time.monotonic()
        try:
            self._offset_s = self._gateway.clock_offset().offset_s if self._gateway else 0.0
        except wsg_gateway.GatewayError as error:
            self._warn(f"the gateway's clock is not known: {error}")

    def _diagnose(self) -> None:
        state = self._gripper.state
        self._shown_fast_stop = state.fast_stop_id if state else None
        serial = str(self._info.serial_number or "")
        name = f"{self.get_name()}: WSG gripper {self._gripper.name}"
        shown = status(name, serial, state, bool(self._gateway and self._gateway.connected), self._motions.outcome)
        message = DiagnosticArray(status=[shown])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    # Actions.

    def _gap_order(self, goal: GripperCommand.Goal) -> Order:
        scale = 1000 if self._value("gripper_command_position") == "gap" else 2000
        force = goal.command.max_effort if goal.command.max_effort > 0 else None
        return self._order(goal.command.position * scale, self._value("speed") * 1000, force)

    def _joint_order(self, goal: ParallelGripperCommand.Goal) -> Order:
        width_mm = self._width_mm(goal.command.position)
        speed_mm_s = goal.command.velocity[0] * 2000 if goal.command.velocity else self._value("speed") * 1000
        return self._order(width_mm, speed_mm_s, goal.command.effort[0] if goal.command.effort else None)

    def _width_mm(self, positions: Sequence[float]) -> float:
        """The width for the position of the joint in m. Raises `ValueError` beyond the limits of the parameters."""
        if len(positions) != 1:
            raise ValueError(f"{len(positions)} positions: send one, that of {self._value('joint')}")
        self._check_width(width_mm := positions[0] * 2000)
        return width_mm

    def _check_width(self, width_mm: float) -> None:
        largest = self._value("max_width") * 1000 or self._info.stroke_mm or float("inf")
        if not self._value("min_width") * 1000 <= width_mm <= largest:
            raise ValueError(f"a width of {width_mm:g} mm: it must be from {self._value('min_width') * 1000:g} to {largest:g}")

    def _order(self, width_mm: float, speed_mm_s: float, force_n: float | None) -> Order:
        """The motion for a goal. Raises `ValueError` beyond the limits of the parameters."""
        self._check_width(width_mm)
        if force_n is not None and force_n > (self._value("max_force") or float("inf")):
            raise ValueError(f"an effort of {force_n:g} N: it must be at most {self._value('max_force'):g}")
        return Order(width_mm, speed_mm_s, force_n, self._value("closing") == "clamp")

    def _accept_gap(self, goal: GripperCommand.Goal) -> GoalResponse:
        return self._accept(self._gap_order, goal)

    def _accept_joint(self, goal: ParallelGripperCommand.Goal) -> GoalResponse:
        return self._accept(self._joint_order, goal)

    def _accept(self, order: Callable[[Any], Order], goal: Any) -> GoalResponse:
        try:
            order(goal)
        except ValueError as error:
            self._warn(f"goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _accepted(self, goal: ServerGoalHandle) -> None:
        self._motions.announce(goal)
        goal.execute()

    def _execute_gap(self, goal: ServerGoalHandle) -> GripperCommand.Result:
        scale = 1000 if self._value("gripper_command_position") == "gap" else 2000

        def filled(message: Any, values: Values) -> Any:
            message.position, message.effort = values.width_mm / scale, values.force_n
            message.stalled, message.reached_goal = values.stalled, values.reached_goal
            return message

        values = self._execute(goal, self._gap_order, GripperCommand.Feedback, filled)
        return filled(GripperCommand.Result(), values)

    def _execute_joint(self, goal: ServerGoalHandle) -> ParallelGripperCommand.Result:
        def filled(message: Any, values: Values) -> Any:
            message.state = self._joint(values)
            return message

        values = self._execute(goal, self._joint_order, ParallelGripperCommand.Feedback, filled)
        result = filled(ParallelGripperCommand.Result(), values)
        result.stalled, result.reached_goal = values.stalled, values.reached_goal
        return result

    def _execute(
        self,
        goal: ServerGoalHandle,
        ordered: Callable[[Any], Order],
        feedback: Any,
        filled: Callable[[Any, Values], Any],
    ) -> Values:
        """Carries a goal out, and says how it ended."""
        order: Order | None = None

        def move(control: wsg_gateway.Control) -> wsg_gateway.Motion:
            # Parameters can have changed since the goal was accepted.
            nonlocal order
            order = ordered(goal.request)
            return order.carry_out(control)

        self._feedback = lambda state: goal.publish_feedback(filled(feedback(), Values.of(state)))
        motion: wsg_gateway.Motion | None = None
        try:
            motion = self._motions.run(goal, move, lambda: goal.is_cancel_requested)
        except (wsg_gateway.GatewayError, TimeoutError, ValueError) as error:
            self._warn(f"goal aborted: {error}")
        finally:
            self._feedback = None
        if not self.context.ok():
            return Values.of(motion)  # Nobody can be told any more.
        if motion is not None and order is not None and order.is_reached(motion):
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
            self._warn(f"goal aborted: {self._motions.outcome}")
        return Values.of(motion)

    # Services.

    def _service(self, name: str, call: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message = call()
                response.success = True
            except (wsg_gateway.GatewayError, TimeoutError, ValueError) as error:
                self._warn(f"{name} failed: {error}")
                response.message = str(error)
            return response

        return answer

    def _home(self) -> str:
        def home(control: wsg_gateway.Control) -> wsg_gateway.Motion:
            motion = control.home()
            assert motion is not None, "home returns None only with if_needed"
            return motion

        return self._moved(home)

    def _release(self) -> str:
        width_mm = self._value("open_width") * 1000 or self._gripper.info().stroke_mm
        if width_mm is None:
            raise ValueError("the stroke is not known: set the parameter open_width")
        return self._moved(lambda control: control.release(width_mm, self._value("speed") * 1000))

    def _moved(self, move: Callable[[wsg_gateway.Control], wsg_gateway.Motion]) -> str:
        """Carries out a motion of a service, which stops a goal that runs. Raises `UnexpectedOutcome`."""
        token = object()
        self._motions.announce(token)
        motion = self._motions.run(token, move)
        if motion is None:
            raise ValueError("a newer goal came first")
        return str(motion.expect().outcome)

    def _fast_stop(self) -> str:
        stop = self._gripper.fast_stop(f"service of {self.get_fully_qualified_name()}")
        return f"{stop.id}, {'confirmed' if stop.confirmed else 'not confirmed yet: it is repeated until it is'}"

    def _acknowledge(self) -> str:
        """Acknowledges the FAST STOP that diagnostics have shown, so that nobody clears one that they have not seen."""
        state = self._gripper.state
        if state is None or not state.fast_stop_id:
            raise ValueError("no FAST STOP is latched")
        if state.fast_stop_id != self._shown_fast_stop:
            raise ValueError("this FAST STOP is new: look at the diagnostics, then call this service again")
        self._gripper.acknowledge(state.fast_stop_id)
        return f"{state.fast_stop_id} acknowledged"

    # Helpers.

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _check(self, name: str, *allowed: str) -> None:
        if self._value(name) not in allowed:
            raise ValueError(f"parameter {name} is {self._value(name)!r}: it must be {' or '.join(map(repr, allowed))}")

    def _warn(self, message: str) -> None:
        self.get_logger().warning(message)

    def _inform(self, message: str) -> None:
        self.get_logger().info(message)

    def close(self) -> None:
        """Gives control up, and closes the connections. Moving fingers stop."""
        if self._gateway is not None:
            self._gateway.close()


def connect(node: GripperNode) -> None:
    """Connects the node, and waits for a gateway that is not there yet."""
    while rclpy.ok():
        try:
            return node.connect()
        except wsg_gateway.Unreachable as error:
            node.get_logger().warning(f"{error}; trying again")
            time.sleep(1)


def main() -> None:
    """Runs the node until Ctrl-C."""
    rclpy.init()
    node = GripperNode()
    try:
        connect(node)
        executor = MultiThreadedExecutor(THREADS)
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # Ctrl-C can come just before rclpy waits again, which it then reports in this way.
        if rclpy.ok():
            raise
    except (KeyError, wsg_gateway.GatewayError) as error:
        sys.exit(f"wsg: {error}")
    finally:
        node.close()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
