"""Servo sessions over a WebSocket, with the simulator's scripts: the fingers follow, and silence stops them."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import time
from collections.abc import Iterator
from typing import Any

import pytest
from gateways import Gateway, running, until
from websockets.sync.client import ClientConnection, connect

# The script of each gripper, and its adapter.
SCRIPTS = {"pd": "position_pd", "width": "width_speed", "watchdog": "script"}
PERIOD_S = 0.02


@pytest.fixture(scope="module")
def steered(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    """A gateway with a simulated gripper for each script, homed."""
    file = tmp_path_factory.mktemp("steering") / "gateway.toml"
    file.write_text("".join(section(script, adapter) for script, adapter in SCRIPTS.items()))
    gateway = Gateway("--config", str(file))
    with running(gateway):
        for script in SCRIPTS:
            assert gateway.post(f"/grippers/{script}/home?wait_ms=60000")["outcome"] == "SUCCESS"
        yield gateway


def section(script: str, adapter: str) -> str:
    own = 'servo_id = 0xB4\nservo_layout = ["width_mm", "speed_mm_s"]\n' if adapter == "script" else ""
    return f'[grippers.{script}]\nurl = "sim://wsg50?steering={script}"\nservo_adapter = "{adapter}"\n{own}'


class Session:
    """A servo session of one gripper."""

    def __init__(self, gateway: Gateway, script: str, socket: ClientConnection, **terms: Any) -> None:
        self.gateway, self.script, self.socket = gateway, script, socket
        self.ids = itertools.count()
        force = {"force_n": 40} if script == "pd" else {}
        self.call("servo.start", max_speed_mm_s=150, **force, **terms)

    def call(self, method: str, **fields: Any) -> Any:
        number = next(self.ids)
        params = {"gripper": self.script, **fields}
        self.socket.send(json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}))
        while (answer := json.loads(self.socket.recv(timeout=10))).get("id") != number:
            pass
        return answer["result"]

    def aim(self, width_mm: float) -> None:
        params = {"gripper": self.script, "width_mm": width_mm}
        self.socket.send(json.dumps({"jsonrpc": "2.0", "method": "servo.target", "params": params}))

    def follow(self, widths_mm: list[float]) -> list[float]:
        """Sends targets, and returns how far the fingers were from each when the next was due."""
        far_mm, due = [], time.monotonic()
        for width_mm in widths_mm:
            self.aim(width_mm)
            due = max(due + PERIOD_S, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            far_mm.append(abs(self.width_mm() - width_mm))
        return far_mm

    def width_mm(self) -> float:
        return float(self.gateway.state(self.script)["width_mm"])


@contextlib.contextmanager
def session_of(gateway: Gateway, script: str, timeout_ms: int) -> Iterator[Session]:
    url = f"ws://127.0.0.1:{gateway.port}/api/v1/ws"
    with connect(url, subprotocols=["wsg.v1"]) as socket:  # type: ignore[list-item]
        yield Session(gateway, script, socket, timeout_ms=timeout_ms)


# Back and forth by 40 mm, at 40 mm/s in the middle, where the targets end.
WAY_MM = [60 + 20 * math.sin(step / 25) for step in range(158)]


def followed(steered: Gateway, script: str) -> tuple[list[float], Any]:
    """How far the fingers were from each target, and the session, which silence has ended."""
    with session_of(steered, script, timeout_ms=500) as session:
        session.follow([60.0] * 60)
        far_mm = session.follow(WAY_MM)
        report = until(lambda: (now := steered.get(f"/grippers/{script}/servo"))["open"] is False and now)
    return far_mm, report


@pytest.mark.parametrize("script", SCRIPTS)
def test_fingers_follow_until_silence(steered: Gateway, script: str) -> None:
    for _ in range(5):
        far_mm, report = followed(steered, script)
        # Other work on the machine can keep the client silent.
        if report["accepted"] == 60 + len(WAY_MM):
            break
    assert (report["ended"], report["adapter"], report["refused"]) == ("silence", SCRIPTS[script], 0), report
    late = sum(each_mm > 10 for each_mm in far_mm)
    assert late < 5, f"{late} times, at most {max(far_mm):.1f} mm: {report}"
    assert report["travel_mm"] > 60, report
    until(lambda: steered.state(script)["moving"] is False)
    stopped_mm = steered.state(script)["width_mm"]
    assert 40 < stopped_mm < 80
    time.sleep(0.5)
    assert abs(steered.state(script)["width_mm"] - stopped_mm) < 0.1


@pytest.mark.parametrize("script", SCRIPTS)
def test_fingers_stay_at_a_target(steered: Gateway, script: str) -> None:
    """The script with gains goes on with its last speed while it gets nothing."""
    with session_of(steered, script, timeout_ms=3000) as session:
        session.follow([60.0] * 60)
        session.aim(80)
        time.sleep(1.5)
        width_mm = session.width_mm()
        report = session.call("servo.stop")
        assert report["ended"] == "ended", report
        assert abs(width_mm - 80) < 2
