"""Action clients, service clients and topic readers of the node."""

from __future__ import annotations

import math
import signal
import threading
import time
from datetime import datetime
from typing import Any

import pytest
import wsg_gateway
from action_msgs.msg import GoalStatus
from conftest import Cell, Client, Nodes
from diagnostic_msgs.msg import DiagnosticStatus
from gateways import Gateway, free_port, running, until
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter
from wsg_gateway_ros.node import GripperNode

SUCCEEDED, ABORTED, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def test_joint_has_the_time_of_its_measurement(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    client.send(0.1)
    until(lambda: len(client.joints) > 30)
    joint = client.joints[-1][1]
    assert joint.name == ["finger_left_joint"] and len(joint.position) == len(joint.velocity) == len(joint.effort) == 1
    assert any(joint.velocity[0] > 0.02 for _, joint in client.joints)
    # While the fingers move, values are some milliseconds old, and never from the future.
    ages = sorted(arrived - seconds(joint.header.stamp) for arrived, joint in client.joints if joint.velocity[0] > 0.02)
    assert -0.002 < ages[0] and ages[len(ages) // 2] < 0.1, ages
    until(lambda: client.joints[-1][1].position[0] == pytest.approx(0.05, abs=0.0002))


def test_grip_ends_when_contact_is_known(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    told: list[Any] = []
    handle = client.send(0.02, 30.0, lambda message: told.append(message.feedback))
    status, result = client.result(handle)
    assert (status, result.stalled, result.reached_goal) == (SUCCEEDED, True, True)
    assert result.position == pytest.approx(0.02, abs=0.001) and result.effort == pytest.approx(30, abs=3)
    assert any(0.025 < feedback.position < 0.055 for feedback in told)


def lateness(cell: Cell, client: Client) -> float:
    """Grips. Returns the time in s from the end that the gripper reported to the arrival of the result."""
    client.result(client.send(0.06))
    future = client.send(0.02, 30.0).get_result_async()
    arrived: list[float] = []
    future.add_done_callback(lambda _: arrived.append(time.time()))
    until(lambda: arrived)
    motion = cell.gateway.get("/grippers/left/commands/latest")
    assert (motion["kind"], motion["outcome"]) == ("grip", "PART_HELD")
    began = datetime.fromisoformat(motion["started_at"].replace("Z", "+00:00")).timestamp()
    return arrived[0] - began - motion["duration_ms"] / 1000


def test_result_comes_within_one_update_of_contact(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    # Other programs on this machine can delay single ones. The gripper sends its values every 20 ms.
    late = sorted(lateness(cell, client) for _ in range(7))
    print("results after the contact, in ms:", [round(1000 * one, 1) for one in late])
    assert -0.002 < late[0] and late[3] < 0.02, late


def test_grip_without_a_part_is_aborted(cell: Cell, nodes: Nodes) -> None:
    status, result = (client := nodes.ready()).result(client.send(0.03, 30.0))
    assert (status, result.stalled, result.reached_goal) == (ABORTED, False, False)


def test_parallel_goal_has_joint_positions(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    status, result = client.result(client.send_joint([0.04], velocity=[0.1]))
    assert (status, result.reached_goal) == (SUCCEEDED, True)
    assert result.state.name == ["finger_left_joint"] and result.state.position[0] == pytest.approx(0.04, abs=0.0002)
    status, result = client.result(client.send_joint([0.01], effort=[25.0]))
    assert (status, result.stalled) == (SUCCEEDED, True)
    assert result.state.effort[0] == pytest.approx(25, abs=3)


def test_clamping_closes_on_any_part(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(closing="clamp", gripper_command_position="joint")
    status, result = client.result(client.send(0.0, 20.0))
    assert (status, result.stalled, result.reached_goal) == (SUCCEEDED, True, False)
    assert result.position == pytest.approx(0.01, abs=0.0005)
    assert client.result(client.send(0.03))[0] == SUCCEEDED
    assert cell.gateway.state()["width_mm"] == pytest.approx(60, abs=0.5)


def test_cancel_is_a_stop(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(speed=0.01)
    handle = client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    client.wait(handle.cancel_goal_async())
    status, result = client.result(handle)
    assert status == CANCELED and not result.reached_goal and result.position < 0.09
    until(lambda: not cell.gateway.state()["moving"])
    assert not cell.gateway.state()["fast_stop"]


def test_newest_goal_wins(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(speed=0.01)
    first = client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    second = client.send_joint([0.015], velocity=[0.2])
    assert client.result(first)[0] == ABORTED
    assert client.result(second)[0] == SUCCEEDED
    assert [width for kind, width in cell.counter.motions if kind == "move"][-2:] == [100, 30]


def test_goal_beyond_the_limits_is_rejected(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(max_width=0.08, max_force=40)
    assert not client.send(0.09).accepted
    assert not client.send(-0.01).accepted
    assert not client.send(0.02, 50.0).accepted
    assert not client.send_joint([0.01, 0.01]).accepted
    assert client.send(0.07).accepted


class ChangedNode(GripperNode):
    """A node of the test, whose limit changes when a goal has been accepted."""

    def _accepted(self, goal: ServerGoalHandle) -> None:
        self.set_parameters([Parameter("max_width", value=0.05)])
        super()._accepted(goal)


@pytest.mark.parametrize("kind", ["gap", "joint"])
def test_goal_beyond_a_new_limit_is_aborted(cell: Cell, nodes: Nodes, kind: str) -> None:
    name = nodes.name()
    url = Parameter("url", value=cell.gateway.url)
    node = ChangedNode(cli_args=["--ros-args", "-r", f"__node:={name}"], parameter_overrides=[url])
    executor = MultiThreadedExecutor(4)
    try:
        node.connect()
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        client = nodes.served(nodes.client(name))
        handle = client.send(0.08) if kind == "gap" else client.send_joint([0.04])
        assert handle.accepted and client.result(handle)[0] == ABORTED
        assert cell.gateway.state()["width_mm"] == pytest.approx(60, abs=0.5)
        # The goal has ended, so that steering may begin.
        until(lambda: node._motions.announce_if_idle(object()), 2)
        assert "a width of 80 mm: it must be from 0 to 50" in node._motions.outcome
    finally:
        node.close()
        executor.shutdown(1)
        node.destroy_node()


def test_fast_stop_and_its_acknowledgement(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(speed=0.01)
    handle = client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    answer = client.call("fast_stop")
    assert answer.success and client.result(handle)[0] == ABORTED
    assert cell.gateway.state()["fast_stop_cause"] == "requested"
    assert client.result(client.send(0.05))[0] == ABORTED
    until(lambda: client.newest_status and "FAST STOP" in client.newest_status.message)
    assert client.newest_status and client.newest_status.level == DiagnosticStatus.ERROR
    assert until(lambda: client.call("acknowledge").success)
    assert not cell.gateway.state()["fast_stop"]
    assert not client.call("acknowledge").success
    until(lambda: client.newest_status and client.newest_status.level == DiagnosticStatus.OK)


def test_fast_stop_that_nobody_has_seen_is_not_acknowledged(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    until(lambda: client.newest_status)
    seen = client.newest_status
    until(lambda: client.newest_status is not seen)
    # Diagnostics come once a second, so that none has shown this FAST STOP yet.
    cell.gateway.post("/grippers/left/fast-stop")
    assert not client.call("acknowledge").success
    assert cell.gateway.state()["fast_stop"]


def test_services_home_and_release(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(open_width=0.05, speed=0.3)
    assert client.call("home").message == "SUCCESS"
    assert client.call("release").success
    assert cell.gateway.state()["width_mm"] == pytest.approx(50, abs=0.5)


def test_other_client_keeps_its_lease_and_its_motion(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(control_timeout=0.5)
    with wsg_gateway.connect(cell.gateway.url) as gateway, gateway["left"].control("cell") as gripper:
        motion: list[wsg_gateway.Motion] = []
        thread = threading.Thread(target=lambda: motion.append(gripper.move(100, 20)))
        thread.start()
        until(lambda: cell.gateway.state()["moving"])
        handle = client.send(0.03)
        client.wait(handle.cancel_goal_async())
        assert client.result(handle)[0] in (ABORTED, CANCELED)
        # A cancelled goal that waits for the lease does not stop the fingers of its holder.
        thread.join()
        assert motion[0].outcome == "SUCCESS"


def test_killed_node_stops_the_fingers(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(speed=0.01)
    client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    nodes.end(signal.SIGKILL)
    state = until(lambda: (now := cell.gateway.state())["fast_stop"] and now)
    assert state["fast_stop_cause"] == "client_lost" and state["lease_holder"] is None


def test_ended_node_stops_without_a_fast_stop(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(speed=0.01, keep_control=True)
    client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    nodes.end(signal.SIGINT)
    until(lambda: not cell.gateway.state()["moving"], 5)
    assert not cell.gateway.state()["fast_stop"] and cell.gateway.state()["lease_holder"] is None


def test_control_is_kept_if_asked(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready(keep_control=True)
    client.result(client.send(0.05))
    assert cell.gateway.state()["lease_holder"] == client.prefix
    client.result(client.send(0.06))
    assert cell.gateway.state()["lease_holder"] == client.prefix


def test_node_waits_for_its_gateway_and_for_a_new_one(nodes: Nodes) -> None:
    gateway = Gateway(port=free_port())
    nodes.url = gateway.url
    client = nodes.start()
    assert not client.gap.wait_for_server(1.5)
    with running(gateway):
        assert client.gap.wait_for_server(10)
        until(client.is_heard)
        until(lambda: client.newest_status and client.newest_status.level == DiagnosticStatus.WARN)
        assert client.newest_status and "not referenced: call the service home" in client.newest_status.message
        # A width that is not known is not published.
        assert not client.joints
        gateway.kill()
        until(lambda: client.newest_status.message.startswith("no connection to the gateway"))
        status, result = client.result(client.send(0.05))
        assert status == ABORTED and math.isnan(result.position)
        gateway.start()
        assert until(lambda: client.call("home").success)
        assert client.result(client.send(0.05))[0] == SUCCEEDED
