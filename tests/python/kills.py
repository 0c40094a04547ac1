"""Kills and cuts at random times, and counts at the device what moved.

usage: kills.py gateway NUMBER | client NUMBER

gateway: a program moves a gripper, each time to a width of its own. Meanwhile the gateway is killed and restarted, frozen,
or cut off from the program. At the end, the motions that the device received are compared with what the program was told.
client: a program that holds the lease is killed or frozen while the fingers move, with each reaction to the loss.
"""

from __future__ import annotations

import contextlib
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import wsg_gateway
from gateways import Device, Gateway, MotionCounter, Proxy, freeze, running, thaw, until
from test_losses import CLIENT

PROBLEMS = (wsg_gateway.ControlLost, wsg_gateway.Refused, wsg_gateway.Unreachable, TimeoutError)


class Program:
    """Moves the gripper until it is asked to end, and notes the outcome that was reported for each motion."""

    def __init__(self, url: str) -> None:
        self.told: dict[float, str] = {}
        self.ends: Counter[str] = Counter()
        self.is_over = False
        self._url = url

    def run(self) -> None:
        with wsg_gateway.connect(self._url) as gateway:
            left = gateway["left"]
            while not self.is_over:
                try:
                    left.wait_for(lambda state: state.link == "connected" and state.moving is False, 10)
                    with left.control("kills", on_loss_moving=random.choice(["stop", "finish"])) as gripper:
                        gripper.home(if_needed=True)
                        while not self.is_over:
                            self._move(gripper)
                except PROBLEMS as problem:
                    self.ends[getattr(problem, "code", type(problem).__name__)] += 1
                    if getattr(problem, "code", None) == "fast_stop":
                        self._acknowledge(left)
                    time.sleep(0.05)

    def _acknowledge(self, left: wsg_gateway.Gripper) -> None:
        """Stands for a person: a lost client can end in a FAST STOP, for example while the link is down."""
        with contextlib.suppress(*PROBLEMS):
            state = left.wait_for(lambda state: state.fast_stop_confirmed, 5)
            left.acknowledge(state.fast_stop_id or "")

    def _move(self, gripper: wsg_gateway.Control) -> None:
        number = len(self.told)
        # Back and forth, to a width that no other motion has.
        width = round(30 + 0.005 * number + 35 * (number % 2), 3)
        self.told[width] = "nothing"
        try:
            self.told[width] = gripper.move(width, 400).outcome or "none"
        except wsg_gateway.ControlLost:
            self.told[width] = "ControlLost"
            raise
        except wsg_gateway.Refused as refused:
            self.told[width] = f"Refused {refused.code}"
            raise


def disturb(gateway: Gateway, proxy: Proxy) -> str:
    """Does one of the three things that can go wrong."""
    kind = random.choices(["kill", "cut", "freeze"], [8, 1, 1])[0]
    if kind == "kill":
        gateway.kill()
        time.sleep(random.choice([0, 0, 1]))
        gateway.start()
    elif kind == "cut":
        proxy.cut()
    else:
        freeze(gateway)
        time.sleep(random.uniform(0.5, 5))
        thaw(gateway)
    return kind


def kill_gateways(number: int) -> None:
    device = Device("fast_stop_on_disconnect=false", part_mm=None)
    with running(device), tempfile.TemporaryDirectory() as directory:
        counter = MotionCounter(device.port)
        gateway = Gateway("--gripper", f"left=tcp://127.0.0.1:{counter.port}", journal=str(Path(directory) / "journal.db"))
        with running(gateway):
            proxy = Proxy(gateway.port)
            program = Program(f"http://127.0.0.1:{proxy.port}")
            thread = threading.Thread(target=program.run)
            thread.start()
            done: Counter[str] = Counter()
            for _ in range(number):
                time.sleep(random.uniform(0, 2))
                done[disturb(gateway, proxy)] += 1
                print(sum(done.values()), dict(done), len(program.told), "motions", flush=True)
            time.sleep(3)
            program.is_over = True
            thread.join(60)
            until(lambda: not gateway.state()["moving"], 10)
        compare(program, counter, done)
        counter.close()


def compare(program: Program, counter: MotionCounter, done: Counter[str]) -> None:
    """Compares the outcomes reported to the program with the motions that the device received."""
    received = Counter(width for kind, width in counter.motions if kind == "move")
    told = Counter(program.told.values())
    wrong = [f"{width} mm moved {count} times" for width, count in received.items() if count > 1]
    wrong += [f"{width} mm was never requested" for width in received if width not in program.told]
    for width, outcome in program.told.items():
        moved = received.get(width, 0)
        if moved and (outcome == "ControlLost" or outcome.startswith("Refused")):
            wrong.append(f"{width} mm moved, but the program was told {outcome}")
        if not moved and outcome == "SUCCESS":
            wrong.append(f"{width} mm did not move, but the program was told {outcome}")
    print(f"disturbances: {dict(done)}\nmotions: {len(program.told)}, at the device: {sum(received.values())}")
    unknown = [width for width, outcome in program.told.items() if outcome == "UNKNOWN"]
    print(f"told: {dict(told)}; of the unknown, {sum(width in received for width in unknown)} reached the device")
    print(f"ends of control: {dict(program.ends)}")
    print("\n".join(wrong) or "nothing moved twice, and nothing was told wrongly")
    sys.exit(bool(wrong))


def kill_clients(number: int) -> None:
    device = Device("fast_stop_on_disconnect=false", part_mm=None)
    with running(device), tempfile.TemporaryDirectory() as directory:
        gateway = Gateway("--gripper", f"left=tcp://127.0.0.1:{device.port}", journal=str(Path(directory) / "journal.db"))
        with running(gateway):
            for kind, loss, ttl_ms in [
                (signal.SIGKILL, "fast_stop", 0),
                (signal.SIGKILL, "stop", 0),
                (signal.SIGKILL, "finish", 0),
                (signal.SIGSTOP, "fast_stop", 0),
                (signal.SIGSTOP, "stop", 0),
                (signal.SIGSTOP, "stop", 500),
            ]:
                times = [lose_client(device, gateway, kind, loss, ttl_ms) for _ in range(number)]
                stopped = sorted(took for took in times if took is not None)
                shown = f"p50 {stopped[len(stopped) // 2]:.3f} s, longest {stopped[-1]:.3f} s" if stopped else "all finished"
                print(f"{kind.name} {loss} ttl_ms={ttl_ms}: {number} times, {shown}", flush=True)


def lose_client(device: Device, gateway: Gateway, kind: signal.Signals, loss: str, ttl_ms: int) -> float | None:
    """Loses one client. Returns how long the fingers went on, or `None` if they finished as they should."""
    command = [sys.executable, "-c", CLIENT, gateway.url, loss, str(ttl_ms)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as client:
        try:
            line = client.stdout and client.stdout.readline()
            assert line == "moves\n", (line, client.stderr and client.stderr.read())
            until(lambda: (device.state()["true_width_mm"] > 31 and device.state()["moving"]) or client.poll() is not None)
            assert client.poll() is None, client.stderr and client.stderr.read()
            time.sleep(random.uniform(0, 0.3))
            client.send_signal(kind)
            started = time.monotonic()
            until(lambda: not device.state()["moving"])
            took = time.monotonic() - started
            width = device.state()["true_width_mm"]
            state = until(lambda: (now := gateway.state())["lease_holder"] is None and now)
            assert bool(state["fast_stop"]) == (loss == "fast_stop"), state
            if loss == "finish":
                assert width > 99.9, width
                return None
            assert width < 99, (width, took)
            return took
        finally:
            client.kill()
            if gateway.state()["fast_stop"]:
                gateway.acknowledge()


if __name__ == "__main__":
    {"gateway": kill_gateways, "client": kill_clients}[sys.argv[1]](int(sys.argv[2]))
