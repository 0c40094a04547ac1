"""Lost connections, killed gateways and killed programs: nothing moves twice, and nothing is reported wrongly."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from gateways import Device, Gateway, MotionCounter, Proxy, running, until
from wsg_gateway import ControlLost, Unreachable

Connect = Callable[..., Any]


class Cell:
    """A device that outlives the gateway, a counter before it, and a gateway with a journal in a file."""

    def __init__(self, directory: Path) -> None:
        # The device keeps its reference, and stops only on command.
        self.device = Device("fast_stop_on_disconnect=false")
        self.journal = directory / "journal.db"
        self.counter: MotionCounter

    def gateway(self, journal: str | None = None, port: int = 0) -> Gateway:
        return Gateway("--gripper", f"left=tcp://127.0.0.1:{self.counter.port}", journal=journal or str(self.journal), port=port)


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    made = Cell(tmp_path)
    with running(made.device):
        made.counter = MotionCounter(made.device.port)
        yield made
        made.counter.close()


def test_killed_gateway_ends_a_motion_as_unknown(connect: Connect, cell: Cell) -> None:
    gateway = cell.gateway()
    lost: list[ControlLost] = []
    with running(gateway), connect(gateway.url) as client, client["left"].control("one", on_lost=lost.append) as gripper:
        gripper.home()
        gripper.move(30, 400)
        threading.Timer(0.4, lambda: (gateway.kill(), gateway.start())).start()
        assert gripper.move(100, 50).outcome == "UNKNOWN"
        until(lambda: lost)
        with pytest.raises(ControlLost):
            gripper.move(30, 50)
        assert cell.counter.motions == [("home", 0.0), ("move", 30.0), ("move", 100.0)]
        until(lambda: client["left"].link == "connected" and client["left"].moving is False)
        with client["left"].control("one") as again:
            assert again.home(if_needed=True) is None
            assert again.move(30, 400).ok


def test_gateway_with_another_journal_knows_nothing(connect: Connect, cell: Cell) -> None:
    gateway = cell.gateway()
    with running(gateway), connect(gateway.url) as client, client["left"].control() as gripper:
        gripper.home()
        other = cell.gateway(":memory:", gateway.port)
        threading.Timer(0.4, lambda: (gateway.kill(), other.start())).start()
        try:
            motion = gripper.move(30, 50)
            assert motion.outcome == "UNKNOWN" and "another journal" in motion.detail
        finally:
            other.kill()


def test_gateway_that_stays_away(connect: Connect, cell: Cell) -> None:
    gateway = cell.gateway()
    with running(gateway), connect(gateway.url) as client, client["left"].control(patience_s=1) as gripper:
        gripper.home()
        threading.Timer(0.3, gateway.kill).start()
        motion = gripper.move(30, 50)
        assert motion.outcome == "UNKNOWN" and "no connection" in motion.detail
        with pytest.raises(ControlLost):
            gripper.move(30, 50)
        with pytest.raises(Unreachable):
            client.clock_offset()


def test_lost_request_moves_nothing(connect: Connect, cell: Cell) -> None:
    """The connection ends with the request: the gateway never sees the motion."""
    gateway = cell.gateway()
    with running(gateway):
        proxy = Proxy(gateway.port)
        with connect(f"http://127.0.0.1:{proxy.port}") as client, client["left"].control(on_loss_moving="stop") as gripper:
            gripper.home()
            proxy.drop_next()
            with pytest.raises(ControlLost, match="the connection"):
                gripper.move(30, 50)
        proxy.close()
    assert cell.counter.motions == [("home", 0.0)]


def test_lost_response_is_found_by_id(connect: Connect, cell: Cell) -> None:
    """The request arrives, and the connection ends before the response."""
    gateway = cell.gateway()
    with running(gateway):
        proxy = Proxy(gateway.port)
        with connect(f"http://127.0.0.1:{proxy.port}") as client, client["left"].control(on_loss_moving="finish") as gripper:
            gripper.home()
            proxy.is_silent_back = True
            threading.Thread(target=lambda: (until(lambda: len(cell.counter.motions) == 2), proxy.cut())).start()
            assert gripper.move(30, 100).outcome == "SUCCESS"
            with pytest.raises(ControlLost):
                gripper.move(31, 100)
        proxy.close()
    assert cell.counter.motions == [("home", 0.0), ("move", 30.0)]


def test_twenty_grips_while_the_gateway_is_killed(cell: Cell) -> None:
    """A program of twelve lines grips twenty parts, each once, although the gateway is killed in the middle."""
    program = Path(__file__).with_name("twenty_grips.py").read_text()
    assert len([line for line in program.splitlines() if line]) <= 12
    gateway = cell.gateway()
    with running(gateway):
        command = [sys.executable, "-c", program.replace("http://127.0.0.1:8080", gateway.url)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
            try:
                until(lambda: cell.counter.grips() >= 6)
                until(lambda: cell.device.state()["moving"])
                gateway.kill()
                gateway.start()
                threading.Thread(target=press_enter, args=(client,), daemon=True).start()
                assert client.stdout is not None
                output = client.stdout.read()
            finally:
                client.kill()
    shown = [line[line.index("PART_HELD") :] for line in output.splitlines() if "PART_HELD" in line]
    assert shown == [f"PART_HELD A-{number}" for number in range(20)], output
    # One grip more than parts at most: the one that was interrupted, after a person has looked.
    assert cell.counter.grips() in (20, 21), cell.counter.motions


def press_enter(client: subprocess.Popen[str]) -> None:
    """Stands for a person, who looks at the gripper for a while after each problem."""
    assert client.stdin is not None
    with contextlib.suppress(OSError, ValueError):
        while client.poll() is None:
            time.sleep(1)
            client.stdin.write("\n")
            client.stdin.flush()


CLIENT = """
import sys, wsg_gateway
url, loss, ttl = sys.argv[1:]
with wsg_gateway.connect(url) as gateway:
    with gateway["left"].control("client", on_loss_moving=loss, ttl_ms=int(ttl) or None) as gripper:
        gripper.home(if_needed=True)
        while True:
            gripper.move(30, 400)
            print("moves", flush=True)
            gripper.move(100, 10)
"""


@pytest.mark.parametrize(("number", "loss", "ttl_ms", "within_s"), [
    (signal.SIGKILL, "fast_stop", 0, 2),
    (signal.SIGKILL, "stop", 0, 2),
    (signal.SIGSTOP, "fast_stop", 0, 6),
    (signal.SIGSTOP, "stop", 500, 3),
])
def test_lost_program_stops_the_fingers(cell: Cell, number: int, loss: str, ttl_ms: int, within_s: float) -> None:
    gateway = cell.gateway()
    with running(gateway):
        command = [sys.executable, "-c", CLIENT, gateway.url, loss, str(ttl_ms)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as client:
            try:
                assert client.stdout is not None and client.stdout.readline() == "moves\n"
                until(lambda: cell.device.state()["moving"])
                client.send_signal(number)
                started = time.monotonic()
                until(lambda: not cell.device.state()["moving"], within_s)
                assert cell.device.state()["true_width_mm"] < 99, time.monotonic() - started
                state = until(lambda: (now := gateway.state())["lease_holder"] is None and now)
                assert bool(state["fast_stop"]) == (loss == "fast_stop")
                if number == signal.SIGSTOP:
                    motions = len(cell.counter.motions)
                    client.send_signal(signal.SIGCONT)
                    # The thawed program learns of the loss, and moves nothing more.
                    assert client.stderr is not None and "ControlLost" in client.stderr.read()
                    assert len(cell.counter.motions) == motions
            finally:
                client.kill()
