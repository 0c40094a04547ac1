"""The node as a program, and a client of it, in a domain of their own."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from control_msgs.action import GripperCommand, ParallelGripperCommand
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.executors import MultiThreadedExecutor
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "python"))
from gateways import Device, Gateway, MotionCounter, until

NODE = os.environ.get("WSG_ROS_NODE", "gripper")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Names a failed test as `tests/run` expects it."""
    if report.failed:
        print(f"\ntest {report.nodeid} ... FAILED")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the numbers for `tests/run`."""
    passed, failed, skipped = (len(terminalreporter.stats.get(kind, ())) for kind in ("passed", "failed", "skipped"))
    failed += len(terminalreporter.stats.get("error", ()))
    print(f"\ntest result: the node for ROS 2. {passed} passed; {failed} failed; {skipped} ignored")


class Cell:
    """A gateway whose gripper has a part of 20 mm, and a counter before the gripper."""

    def __init__(self) -> None:
        self.device = Device("fast_stop_on_disconnect=false")
        self.device.start()
        self.counter = MotionCounter(self.device.port)
        self.gateway = Gateway("--gripper", f"left=tcp://127.0.0.1:{self.counter.port}")
        self.gateway.start()

    def close(self) -> None:
        self.gateway.kill()
        self.counter.close()
        self.device.kill()


class Client:
    """A program that uses the node."""

    def __init__(self, name: str) -> None:
        self.node = rclpy.create_node(f"client_{name}")
        self.prefix = f"/{name}"
        self.joints: list[tuple[float, JointState]] = []
        self.newest_status: DiagnosticStatus | None = None
        self.node.create_subscription(JointState, "/joint_states", lambda one: self.joints.append((time.time(), one)), 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 10)
        self.gap = ActionClient(self.node, GripperCommand, f"{self.prefix}/gripper_cmd")
        self.joint = ActionClient(self.node, ParallelGripperCommand, f"{self.prefix}/parallel_gripper_cmd")
        self.executor = MultiThreadedExecutor(4)
        self.executor.add_node(self.node)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def _diagnosed(self, message: DiagnosticArray) -> None:
        self.newest_status = message.status[0]

    def wait(self, future: Any, timeout_s: float = 20.0) -> Any:
        until(future.done, timeout_s)
        return future.result()

    def is_heard(self) -> bool:
        """Whether the node answers. Discovery can know a server before the server knows this client.

        The goals are beyond the limits, so that nothing moves.
        """
        gap, joint = GripperCommand.Goal(), ParallelGripperCommand.Goal(command=JointState(position=[-1.0]))
        gap.command.position = -1.0
        futures = [self.gap.send_goal_async(gap), self.joint.send_goal_async(joint)]
        try:
            return all(not self.wait(future, 1).accepted for future in futures)
        except AssertionError:
            return False

    def send(self, position: float, effort: float = 0.0, feedback: Any = None) -> Any:
        """Sends a goal of GripperCommand, whose position is the width in m. Returns its handle."""
        goal = GripperCommand.Goal()
        goal.command.position, goal.command.max_effort = position, effort
        return self.wait(self.gap.send_goal_async(goal, feedback_callback=feedback))

    def send_joint(self, position: list[float], **values: list[float]) -> Any:
        """Sends a goal of ParallelGripperCommand, whose position is that of the joint in m."""
        command = JointState(position=position, **values)
        return self.wait(self.joint.send_goal_async(ParallelGripperCommand.Goal(command=command)))

    def result(self, handle: Any) -> tuple[int, Any]:
        answer = self.wait(handle.get_result_async())
        return answer.status, answer.result

    def call(self, service: str) -> Trigger.Response:
        client = self.node.create_client(Trigger, f"{self.prefix}/{service}")
        assert client.wait_for_service(10)
        return self.wait(client.call_async(Trigger.Request()))

    def close(self) -> None:
        for timer in self.node.timers:
            timer.cancel()
        self.executor.shutdown(1)
        self.node.destroy_node()


@pytest.fixture(scope="session", autouse=True)
def ros() -> Iterator[None]:
    """No other program on this network sees the tests."""
    os.environ |= {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    rclpy.init()
    yield
    rclpy.shutdown()


@pytest.fixture(scope="session")
def cell() -> Iterator[Cell]:
    made = Cell()
    yield made
    made.close()


class Nodes:
    """The nodes that a test starts."""

    # Discovery remembers a killed node for a while, so that each one has a name of its own.
    numbers = itertools.count(1)

    def __init__(self, url: str) -> None:
        self.url = url
        self.processes: list[subprocess.Popen[bytes]] = []
        self.clients: list[Client] = []

    def name(self) -> str:
        """Name of the next node."""
        return f"wsg_{next(self.numbers)}"

    def client(self, name: str) -> Client:
        """Returns a client of a node."""
        self.clients.append(client := Client(name))
        return client

    def start(self, **parameters: Any) -> Client:
        """Starts a node, and returns a client of it."""
        name = self.name()
        values = {"url": self.url, **parameters}
        flags = [flag for key, value in values.items() for flag in ("-p", f"{key}:={value}")]
        self.processes.append(subprocess.Popen([NODE, "--ros-args", "-r", f"__node:={name}", *flags]))
        return self.client(name)

    def ready(self, **parameters: Any) -> Client:
        """Starts a node, and returns a client once it serves."""
        return self.served(self.start(**parameters))

    def served(self, client: Client) -> Client:
        """Returns the client once its node serves."""
        assert client.gap.wait_for_server(20) and client.joint.wait_for_server(20)
        until(client.is_heard)
        return client

    def end(self, number: int) -> None:
        """Ends the nodes by a signal."""
        ended, self.processes = self.processes, []
        for process in ended:
            process.send_signal(number)
            try:
                assert number == signal.SIGKILL or process.wait(10) == 0
            finally:
                process.kill()
                process.wait()

    def close(self) -> None:
        self.end(signal.SIGINT)
        for client in self.clients:
            client.close()


@pytest.fixture
def nodes(cell: Cell) -> Iterator[Nodes]:
    """Nodes of the gateway, whose gripper is homed, open, and free of FAST STOPs."""
    if cell.gateway.state()["fast_stop"]:
        cell.gateway.acknowledge()
    if not cell.gateway.state()["referenced"]:
        cell.gateway.post("/grippers/left/home")
    cell.gateway.post("/grippers/left/release", width_mm=60, speed_mm_s=300)
    made = Nodes(cell.gateway.url)
    yield made
    made.close()
