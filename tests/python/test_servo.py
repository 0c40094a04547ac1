"""Servo sessions, at a simulated gripper whose script steers the fingers."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest
import wsg_gateway
from gateways import Device, Gateway, running, until
from wsg_gateway import ControlLost, Refused, ServoEnded

Connect = Callable[..., Any]


class Cell:
    """A gripper in a process of its own, and its gateway."""

    def __init__(self) -> None:
        self.device = Device("steering=width", "steering_period_ms=5", "fast_stop_on_disconnect=false", part_mm=None)
        self.gateway = Gateway("--gripper", f"left=tcp://127.0.0.1:{self.device.port}")

    def width_mm(self) -> float:
        """The opening width at the gripper itself."""
        return float(self.device.state()["true_width_mm"])

    def stands_still(self) -> bool:
        before = self.width_mm()
        time.sleep(0.1)
        return self.width_mm() == before


@pytest.fixture(scope="module")
def made() -> Iterator[Cell]:
    cell = Cell()
    with running(cell.device, cell.gateway):
        yield cell


@pytest.fixture
def cell(made: Cell) -> Cell:
    """The cell, whose gripper is homed, open, and free of FAST STOPs."""
    gateway = made.gateway
    if gateway.state()["fast_stop"]:
        gateway.acknowledge()
    if not gateway.state()["referenced"]:
        gateway.post("/grippers/left/home")
    gateway.post("/grippers/left/move", width_mm=60, speed_mm_s=400)
    return made


@contextlib.contextmanager
def steering(connect: Connect, cell: Cell, **terms: Any) -> Iterator[tuple[Any, Any, Any]]:
    """A client, its gripper under control, and its open session. Other programs can delay its targets."""
    with connect(cell.gateway.url) as client, client["left"].control("policy") as gripper:
        with gripper.servo(**{"adapter": "width_speed", "timeout_ms": 3000, **terms}) as servo:
            yield client, gripper, servo


def steer_until_ended(servo: Any, width_mm: float = 20.0) -> ServoEnded:
    """Steers at 50 Hz until the session has ended."""
    with pytest.raises(ServoEnded) as ended:
        for _ in range(500):
            servo.target(width_mm)
            time.sleep(0.02)
    assert ended.value.reason == servo.ended and ended.value.gripper == "left"
    with pytest.raises(ServoEnded):
        servo.target(width_mm)
    return ended.value


def test_targets_move_the_fingers(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell, max_speed_mm_s=200) as (client, _, servo):
        assert servo.ended is None and servo.applied_mm is None and servo.age_ms is None
        before = next(client._core.main._ids)
        for step in range(100):
            servo.target(50 + 20 * math.sin(step / 10))
            time.sleep(0.02)
        until(lambda: servo.report.accepted > 30 and servo.applied_mm == pytest.approx(50 + 20 * math.sin(9.9), abs=0.01))
        assert cell.width_mm() == pytest.approx(servo.applied_mm, abs=2)
        assert servo.age_ms >= 0
        # Neither targets nor feedback are requests that wait for an answer.
        assert next(client._core.main._ids) == before + 1
    assert servo.ended == "ended" and not servo.report.open
    assert servo.report.travel_mm > 30 and servo.report.refused == 0
    until(cell.stands_still)


def test_newest_target_wins_and_none_blocks(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell) as (client, _, servo):
        blocked, released, were_free = threading.Event(), threading.Event(), []
        client._engine.loop.call_soon_threadsafe(lambda: (blocked.set(), were_free.append(released.wait(2))))
        blocked.wait()
        # Nothing is sent meanwhile, and nothing waits for that.
        for step in range(50):
            servo.target(20 + step / 2)
        released.set()
        until(lambda: servo.applied_mm == pytest.approx(44.5, abs=0.01))
        assert were_free == [True] and servo.report.accepted == 1
        # A program without a pause sends no more than the gateway takes.
        until(lambda: servo.target(30.0) or cell.width_mm() == pytest.approx(30, abs=0.1))
        assert servo.ended is None


def test_rate_is_that_of_the_gripper(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell) as (_, _, servo):

        def rate_hz() -> float | None:
            # The gripper takes a target every 5 ms, so some of these have to wait for it.
            for _ in range(10):
                servo.target(30.0)
                time.sleep(0.002)
            return servo.rate_hz

        assert until(rate_hz) > 20


def test_exception_stops_the_fingers(connect: Connect, cell: Cell) -> None:
    with connect(cell.gateway.url) as client, client["left"].control() as gripper:
        with pytest.raises(ZeroDivisionError), gripper.servo(adapter="width_speed", max_speed_mm_s=20, timeout_ms=5000) as servo:
            servo.target(10)
            until(lambda: cell.width_mm() < 58)
            _ = 1 / 0
        until(cell.stands_still, 1)
        assert cell.width_mm() > 30 and servo.ended == "ended"
        with pytest.raises(ServoEnded, match=r"left has ended \(ended\): its block has ended"):
            servo.target(10)
        # The lease is still there.
        assert gripper.held and gripper.move(60, 400).ok
    assert cell.gateway.state()["fast_stop"] is False


def test_fast_stop_of_somebody_is_an_exception(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell, max_speed_mm_s=20) as (client, gripper, servo):
        threading.Timer(0.3, cell.gateway.post, ["/grippers/left/fast-stop"]).start()
        ended = steer_until_ended(servo)
        assert ended.reason == "fast_stop" and "FAST STOP" in ended.detail
        assert gripper.held and cell.width_mm() > 30
        until(cell.stands_still, 1)
        before = next(client._core.main._ids)
        with pytest.raises(ServoEnded):
            servo.follow([30, 32], dt_ms=100)
        assert next(client._core.main._ids) == before + 1
        with pytest.raises(Refused, match="fast_stop"), gripper.servo(adapter="width_speed"):
            pass
    assert servo.ended == "fast_stop"


def test_stop_ends_the_session(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell, max_speed_mm_s=20) as (_, gripper, servo):
        threading.Timer(0.3, cell.gateway.post, ["/grippers/left/stop"]).start()
        assert steer_until_ended(servo).reason == "stop"
        until(cell.stands_still, 1)
        with gripper.servo(adapter="width_speed", timeout_ms=3000) as again:
            until(lambda: again.target(40.0) or cell.width_mm() == pytest.approx(40, abs=0.1))


def test_silence_ends_the_session(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell, max_speed_mm_s=10, timeout_ms=200) as (_, _, servo):
        servo.target(20)
        until(lambda: servo.ended == "silence", 3)
        until(cell.stands_still, 1)
        assert cell.width_mm() > 40
        with pytest.raises(ServoEnded, match="the gateway accepted no target for 200 ms"):
            servo.target(20)
    assert servo.report.accepted == 1


@pytest.mark.parametrize("loss", ["force", "connection"])
def test_lost_lease_ends_the_session(connect: Connect, cell: Cell, loss: str) -> None:
    with steering(connect, cell, max_speed_mm_s=10) as (client, gripper, servo):
        servo.target(20)
        if loss == "force":
            cell.gateway.post("/grippers/left/lease", holder="boss", force=True, ttl_ms=2000)
        else:
            client._engine.loop.call_soon_threadsafe(client._core.main._socket.transport.abort)
        ended = steer_until_ended(servo)
        assert ended.reason == "lease"
        assert ("another client has it" if loss == "force" else "connection") in ended.detail
        until(cell.stands_still, 1)
        with pytest.raises(ControlLost):
            gripper.move(50)
    assert servo.ended == "lease"
    until(lambda: cell.gateway.state()["lease_holder"] is None)


def test_series_is_played(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell) as (_, _, servo):
        started, seen = time.monotonic(), set()
        servo.follow([60, 55, 50, 45, 40], dt_ms=100)
        until(lambda: seen.add(servo.applied_mm) or servo.applied_mm == 40)
        assert time.monotonic() - started > 0.35
        # The gateway has interpolated between the widths.
        assert seen - {None, 60, 55, 50, 45, 40} and all(40 <= width <= 60 for width in seen - {None})
        assert servo.report.accepted == 1
        until(lambda: cell.width_mm() == pytest.approx(40, abs=0.1), 1)
        # A newer target replaces the rest of a series.
        servo.follow(np.linspace(40, 80, 100, dtype=np.float32), dt_ms=50)
        until(lambda: cell.width_mm() > 42)
        until(lambda: servo.target(np.float32(30.5)) or cell.width_mm() == pytest.approx(30.5, abs=0.1))


def test_wrong_values_are_refused_here(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell, max_speed_mm_s=100, timeout_ms=3000) as (_, gripper, servo):
        for wrong in (math.nan, -1, 2000, math.inf, np.float32("nan")):
            with pytest.raises(ValueError, match="it must be a number from 0"):
                servo.target(wrong)
        with pytest.raises(ValueError, match="speed_mm_s is 101: it must be from 0 to max_speed_mm_s, 100"):
            servo.target(30, 101)
        for widths, dt_ms in [([], 20), ([30] * 257, 20), ([30, 31], 0), ([30, 31], 20.5), ([30] * 200, 100)]:
            with pytest.raises(ValueError, match="1 to 256 widths, with 1 to 1000 ms between"):
                servo.follow(widths, dt_ms)
        with pytest.raises(ValueError, match="the widths need 200 mm/s: max_speed_mm_s is 100"):
            servo.follow([30, 34], dt_ms=20)
        with pytest.raises(ValueError, match="no time zone"):
            servo.target(30, at=datetime(2026, 1, 1))
        with pytest.raises(Refused, match="already_running"):
            gripper.move(50)
        with pytest.raises(Refused, match="already_running"), gripper.servo(adapter="width_speed"):
            pass
        assert servo.ended is None and servo.report.accepted == servo.report.refused == 0
        with pytest.raises(RuntimeError, match="has not begun"):
            gripper.servo().target(30)
        with pytest.raises(Refused, match="timeout_ms"), gripper.servo(timeout_ms=1):
            pass


def test_refused_targets_are_counted(connect: Connect, cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    with steering(connect, cell, timeout_ms=300) as (_, _, servo):
        servo.target(999)
        until(lambda: servo.report.refused == 1)
        old = datetime.now(timezone.utc) - timedelta(seconds=5)
        servo.target(50, at=old)
        until(lambda: servo.report.refused == 2)
        assert "the gateway refused a target of left" in caplog.text
        until(lambda: servo.ended, 3)
        with pytest.raises(ServoEnded, match="accepted no target for 300 ms, and refused 2"):
            servo.target(50, at=datetime.now(timezone.utc))


def test_gripper_without_a_script_is_steered_by_motions(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url, max_hz=100) as client, client["right"].control() as gripper:
        gripper.move(60, 400)
        with gripper.servo(max_speed_mm_s=150, timeout_ms=3000) as servo:
            until(lambda: servo.target(40.0) or gripper.width_mm == pytest.approx(40, abs=0.5))
            assert servo.report.adapter == "moves"
        assert gripper.move(60, 400).ok


@pytest.mark.parametrize("adapter", ["moves", "width_speed"])
@pytest.mark.parametrize("targets", [1, 10])
def test_next_motion_is_not_refused(connect: Connect, cell: Cell, adapter: str, targets: int) -> None:
    with connect(cell.gateway.url) as client, client["left"].control() as gripper:
        for width_mm in (20, 80, 20, 80):
            with gripper.servo(adapter=adapter, timeout_ms=3000, max_speed_mm_s=20) as servo:
                for _ in range(targets):
                    servo.target(width_mm)
                    time.sleep(0.01)
            assert gripper.move(50, 400).ok


def test_telemetry_is_subscribed_again_after_a_lost_connection(connect: Connect, cell: Cell) -> None:
    with steering(connect, cell) as (client, _, servo):
        client._engine.loop.call_soon_threadsafe(client._core.main._socket.transport.abort)
        assert steer_until_ended(servo).reason == "lease"
        until(lambda: client.connected and client._core.main.generation == 2)
        until(lambda: cell.gateway.state()["lease_holder"] is None)
        if cell.gateway.state()["fast_stop"]:
            cell.gateway.acknowledge()
        with client["left"].control() as gripper, gripper.servo(adapter="width_speed", timeout_ms=3000) as again:
            until(lambda: again.target(40.0) or again.applied_mm == 40)


def test_names_are_the_same_in_both_modules() -> None:
    for name in ("Control", "Servo"):
        one, other = (set(vars(getattr(module, name))) for module in (wsg_gateway, wsg_gateway.aio))
        assert {name for name in one if not name.startswith("_")} == {name for name in other if not name.startswith("_")}
