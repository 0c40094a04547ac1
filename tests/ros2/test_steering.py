"""Publishers of targets, which steer the fingers."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest
import wsg_gateway
from action_msgs.msg import GoalStatus
from conftest import Cell, Client, Nodes
from gateways import until
from rcl_interfaces.msg import Log
from std_msgs.msg import Float64MultiArray

# Other programs on this machine can delay single targets.
TIMEOUT_S = 2


class Publisher:
    """Publishes its `position` at 50 Hz, and reads the log of the node."""

    def __init__(self, client: Client) -> None:
        self.said: list[str] = []
        self.client = client
        self.logs = client.node.create_subscription(Log, "/rosout", self._logged, 100)
        self.publisher = client.node.create_publisher(Float64MultiArray, f"{client.prefix}/commands", 1)
        self.position: list[float] | None = None
        client.node.create_timer(0.02, self._publish)

    def _logged(self, message: Log) -> None:
        if message.name == self.client.prefix[1:]:
            self.said.append(message.msg)

    def _publish(self) -> None:
        if self.position is not None:
            self.publisher.publish(Float64MultiArray(data=self.position))

    def has_said(self, text: str) -> bool:
        return any(text in line for line in self.said)

    def is_matched(self) -> bool:
        return self.publisher.get_subscription_count() == 1 and self.logs.get_publisher_count() > 0


def publisher(nodes: Nodes, **parameters: Any) -> Publisher:
    made = Publisher(nodes.ready(steering=True, **{"steering_timeout": TIMEOUT_S, **parameters}))
    until(made.is_matched)
    return made


def session(cell: Cell) -> Any:
    return cell.gateway.get("/grippers/left/servo")


def sessions(cell: Cell) -> int:
    """Number of sessions that have begun."""
    events = cell.gateway.get("/events?limit=1000&kind=device")["events"]
    return sum(event["event"] == "servo_started" for event in events)


def width_mm(cell: Cell) -> float:
    return float(cell.device.state()["true_width_mm"])


def stands_still(cell: Cell) -> bool:
    before = width_mm(cell)
    time.sleep(0.2)
    return width_mm(cell) == before


def test_steering_is_off_by_default(cell: Cell, nodes: Nodes) -> None:
    client = nodes.ready()
    assert client.node.count_subscribers(f"{client.prefix}/commands") == 0


def test_targets_move_the_fingers_and_a_pause_ends_the_session(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes, speed=0.2)
    before = sessions(cell)
    steering.position = [0.02]
    until(lambda: width_mm(cell) == pytest.approx(40, abs=0.5))
    steering.position = [0.035]
    until(lambda: width_mm(cell) == pytest.approx(70, abs=0.5))
    assert cell.gateway.state()["lease_holder"] == steering.client.prefix
    assert session(cell)["open"] and session(cell)["max_speed_mm_s"] == 200 and sessions(cell) == before + 1
    steering.position = None
    until(lambda: session(cell)["ended"] == "silence" and cell.gateway.state()["lease_holder"] is None)
    until(lambda: steering.has_said("steering has ended: silence"))
    # The first target after the pause begins a new session.
    steering.position = [0.03]
    until(lambda: width_mm(cell) == pytest.approx(60, abs=0.5))
    assert sessions(cell) == before + 2


def test_silence_stops_the_fingers(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes, speed=0.01, steering_timeout=0.5)
    steering.position = [0.0]
    until(lambda: width_mm(cell) < 59)
    steering.position = None
    until(lambda: session(cell)["ended"] == "silence" and stands_still(cell))
    assert width_mm(cell) > 40 and not cell.gateway.state()["fast_stop"]


def goal(client: Client) -> None:
    status, result = client.result(client.send(0.05))
    assert status == GoalStatus.STATUS_SUCCEEDED and result.position == pytest.approx(0.05, abs=0.001)


def service(client: Client) -> None:
    answer = client.call("release")
    assert answer.success, answer.message


@pytest.mark.parametrize("moves", [goal, service])
def test_goals_and_services_end_steering(cell: Cell, nodes: Nodes, moves: Callable[[Client], None]) -> None:
    steering = publisher(nodes, open_width=0.05)
    steering.position = [0.02]
    until(lambda: width_mm(cell) == pytest.approx(40, abs=0.5))
    before = sessions(cell)
    moves(steering.client)
    until(lambda: steering.has_said("steering has ended: a goal or a service moves the gripper"))
    # Targets that go on do not move the fingers away.
    time.sleep(1.5)
    assert width_mm(cell) == pytest.approx(50, abs=0.5) and sessions(cell) == before
    steering.position = None
    time.sleep(TIMEOUT_S + 0.5)
    steering.position = [0.02]
    until(lambda: width_mm(cell) == pytest.approx(40, abs=0.5))


def test_goal_that_runs_is_not_disturbed(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes, speed=0.02)
    handle = steering.client.send(0.1)
    until(lambda: cell.gateway.state()["moving"])
    steering.position = [0.02]
    until(lambda: steering.has_said("targets are ignored while a goal or a service moves the gripper"))
    assert steering.client.result(handle)[0] == GoalStatus.STATUS_SUCCEEDED
    time.sleep(0.5)
    assert width_mm(cell) == pytest.approx(100, abs=0.5)


@pytest.mark.parametrize("path", ["stop", "fast-stop"])
def test_stop_of_somebody_holds(cell: Cell, nodes: Nodes, path: str) -> None:
    steering = publisher(nodes, speed=0.02)
    steering.position = [0.0]
    until(lambda: width_mm(cell) < 58)
    before = sessions(cell)
    cell.gateway.post(f"/grippers/left/{path}")
    until(lambda: steering.has_said(f"steering has ended: {path.replace('-', '_')}"))
    until(lambda: stands_still(cell))
    stopped_mm = width_mm(cell)
    time.sleep(1)
    assert width_mm(cell) == stopped_mm and sessions(cell) == before
    steering.position = None
    time.sleep(TIMEOUT_S + 0.5)
    steering.position = [0.04]
    if path == "stop":
        until(lambda: sessions(cell) == before + 1)
    else:
        until(lambda: steering.has_said("steering did not begin: fast_stop"))
        assert sessions(cell) == before and width_mm(cell) == stopped_mm


@pytest.mark.parametrize("wrong", [0.041, math.nan])
def test_wrong_targets_are_no_pause(cell: Cell, nodes: Nodes, wrong: float) -> None:
    steering = publisher(nodes, speed=0.02, max_width=0.08)
    steering.position = [0.0]
    until(lambda: width_mm(cell) < 58)
    before = sessions(cell)
    cell.gateway.post("/grippers/left/stop")
    until(lambda: steering.has_said("steering has ended: stop"))
    until(lambda: stands_still(cell))
    stopped_mm = width_mm(cell)
    steering.position = [wrong]
    time.sleep(TIMEOUT_S + 0.5)
    steering.position = [0.0]
    time.sleep(1)
    assert width_mm(cell) == stopped_mm and sessions(cell) == before
    # Only a pause begins a new session, also if wrong targets come first.
    steering.position = None
    time.sleep(TIMEOUT_S + 0.5)
    steering.position = [wrong]
    time.sleep(0.2)
    steering.position = [0.0]
    until(lambda: sessions(cell) == before + 1)


def test_wrong_targets_end_the_session(cell: Cell, nodes: Nodes) -> None:
    # So slow that the fingers are far from the target after the timeout.
    steering = publisher(nodes, speed=0.005)
    steering.position = [0.0]
    until(lambda: width_mm(cell) < 59)
    steering.position = [-0.01]
    until(lambda: steering.has_said("steering has ended: silence") and stands_still(cell))
    stopped_mm = width_mm(cell)
    # A Stop at this time would not be noticed, so that further targets need a pause here, too.
    cell.gateway.post("/grippers/left/stop")
    before = sessions(cell)
    steering.position = [0.0]
    time.sleep(1)
    assert width_mm(cell) == stopped_mm > 30 and sessions(cell) == before


def test_wrong_targets_are_ignored(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes, max_width=0.08)
    before = sessions(cell)
    for wrong, said in [
        ([], "0 positions: send one"),
        ([0.02, 0.02], "2 positions: send one"),
        ([0.041], "a width of 82 mm: it must be from 0 to 80"),
        ([-0.01], "a width of -20 mm"),
        ([math.nan], "a width of nan mm"),
    ]:
        steering.position = wrong
        until(lambda said=said: steering.has_said(said))
    assert sessions(cell) == before and width_mm(cell) == pytest.approx(60, abs=0.5)


def test_lease_of_another_client_is_respected(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes)
    before = sessions(cell)
    with wsg_gateway.connect(cell.gateway.url) as gateway, gateway["left"].control("cell"):
        steering.position = [0.02]
        # Steering does not wait for the lease: a person could send a Stop meanwhile.
        until(lambda: steering.has_said("steering did not begin: lease_held"), 3)
        cell.gateway.post("/grippers/left/stop")
    until(lambda: cell.gateway.state()["lease_holder"] is None)
    time.sleep(1)
    assert width_mm(cell) == pytest.approx(60, abs=0.5) and sessions(cell) == before


def test_node_that_ends_stops_the_fingers(cell: Cell, nodes: Nodes) -> None:
    steering = publisher(nodes, speed=0.01)
    steering.position = [0.0]
    until(lambda: width_mm(cell) < 59)
    nodes.end(signal.SIGINT)
    until(lambda: stands_still(cell))
    state = cell.gateway.state()
    assert width_mm(cell) > 30 and not state["fast_stop"] and state["lease_holder"] is None
