"""Servo sessions with the simulator's scripts: the fingers follow, silence stops them, and other clients do not disturb."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from gateways import Gateway, free_port, running, until
from steering_rates import ServoOverZenoh, paced, zenoh_session
from websockets.sync.client import ClientConnection, connect

# The script of each gripper, and its adapter.
SCRIPTS = {"pd": "position_pd", "width": "width_speed", "watchdog": "script"}
PERIOD_S = 0.02


@pytest.fixture(scope="module")
def steered(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    """A gateway with a simulated gripper for each script, homed."""
    file = tmp_path_factory.mktemp("steering") / "gateway.toml"
    file.write_text("".join(section(script, adapter) for script, adapter in SCRIPTS.items()))
    gateway = Gateway("--config", str(file), zenoh=f"tcp/127.0.0.1:{free_port()}")
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

    def follow(self, widths_mm: list[float]) -> list[float | None]:
        """Sends targets, and returns how far the fingers were from each when the next was due, as far as that is known."""
        far_mm: list[float | None] = []
        due = time.monotonic()
        for width_mm in widths_mm:
            self.aim(width_mm)
            due = max(due + PERIOD_S, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            at_mm = self.gateway.state(self.script)["width_mm"]
            far_mm.append(None if at_mm is None else abs(at_mm - width_mm))
        return far_mm


@contextlib.contextmanager
def session_of(gateway: Gateway, script: str, timeout_ms: int) -> Iterator[Session]:
    url = f"ws://127.0.0.1:{gateway.port}/api/v1/ws"
    with connect(url, subprotocols=["wsg.v1"]) as socket:  # type: ignore[list-item]
        yield Session(gateway, script, socket, timeout_ms=timeout_ms)


# Back and forth by 40 mm, at 40 mm/s in the middle, where the targets end.
WAY_MM = [60 + 20 * math.sin(step / 25) for step in range(158)]


def width_mm(gateway: Gateway, script: str) -> float:
    """The width of the fingers, which is unknown for a moment if other work delays the gateway."""
    return float(until(lambda: gateway.state(script)["width_mm"]))


def followed(steered: Gateway, script: str) -> tuple[list[float], Any]:
    """How far the fingers were from each target, and the session, which silence has ended."""
    for _ in range(5):
        with session_of(steered, script, timeout_ms=500) as session:
            session.follow([60.0] * 60)
            far_mm = [each_mm for each_mm in session.follow(WAY_MM) if each_mm is not None]
            report = until(lambda: (now := steered.get(f"/grippers/{script}/servo"))["open"] is False and now)
        # Other work on the machine can keep the client silent, or delay the gateway.
        if report["accepted"] == 60 + len(WAY_MM) and len(far_mm) == len(WAY_MM):
            return far_mm, report
    raise AssertionError(report)


@pytest.mark.parametrize("script", SCRIPTS)
def test_fingers_follow_until_silence(steered: Gateway, script: str) -> None:
    far_mm, report = followed(steered, script)
    assert (report["ended"], report["adapter"], report["refused"]) == ("silence", SCRIPTS[script], 0), report
    late = sum(each_mm > 10 for each_mm in far_mm)
    assert late < 5, f"{late} times, at most {max(far_mm):.1f} mm: {report}"
    assert report["travel_mm"] > 60, report
    until(lambda: steered.state(script)["moving"] is False)
    stopped_mm = width_mm(steered, script)
    assert 40 < stopped_mm < 80
    time.sleep(0.5)
    assert abs(width_mm(steered, script) - stopped_mm) < 0.1


@pytest.mark.parametrize("series", [False, True])
@pytest.mark.parametrize("script", SCRIPTS)
def test_fingers_stay_at_the_last_target(steered: Gateway, script: str, series: bool) -> None:
    """The script with gains goes on with its last speed while it gets nothing."""
    with session_of(steered, script, timeout_ms=3000) as session:
        session.follow([60.0] * 60)
        if series:
            session.call("servo.follow", widths_mm=[78, 80], dt_ms=50)
        else:
            session.aim(80)
        time.sleep(1.5)
        rest_mm = width_mm(steered, script)
        report = session.call("servo.stop")
        assert report["ended"] == "ended", report
        assert abs(rest_mm - 80) < 2


def test_puts_of_another_client_cost_no_target(steered: Gateway) -> None:
    """They are refused, and the answers to them are delayed."""
    with zenoh_session(steered.zenoh) as session, zenoh_session(steered.zenoh) as other:
        client = ServoOverZenoh(session, "width", "width_speed")
        flood = other.declare_publisher("wsg/v1/gateway/width/command/servo.target")
        flooding = threading.Event()
        flooding.set()

        def put() -> None:
            while flooding.is_set():
                flood.put(json.dumps({"width_mm": 50, "client": "other"}))
                time.sleep(0.002)

        thread = threading.Thread(target=put)
        client.call("servo.start", {"timeout_ms": 5000})
        thread.start()
        try:
            paced(50, 200, lambda number: client.send(client.encoded(70 + number / 64)))
            report = client.call("servo.stop", {})
        finally:
            flooding.clear()
            thread.join()
        # Other work on the machine can let a newer target replace one.
        assert report["accepted"] > 180, report
