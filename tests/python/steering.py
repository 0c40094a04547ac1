"""Steers independent devices through a gateway, whose clients are frozen, fall silent, or are stopped.

usage: steering.py stops [NUMBER [GRIPPERS [PERIOD_MS]]]

Each happens NUMBER times. Each Stop is counted at the device, whose script takes a request per period.
"""

from __future__ import annotations

import json
import random
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from gateways import Gateway, free_port
from steered import ABORTED, STEER, STOP, SUCCESS, Driver, width

SILENCE_S = 0.5
# Longest delay of a Stop after this time.
LATE_S = 0.02
# A client that is stopped sends on for this time, and then pauses, so that its stream may begin anew.
INSISTS_S, PAUSES_S = 0.3, 0.6


class Devices:
    """Devices in a process of their own, so that clients do not delay them."""

    def __init__(self, count: int, period_s: float) -> None:
        program = [sys.executable, str(Path(__file__).with_name("steered.py")), str(count), str(period_s)]
        self.process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.lock = threading.Lock()
        self.ports: list[int] = json.loads(self._line())

    def log(self, device: int, first: int = 0) -> list[list[float]]:
        """Requests of the script, and Stops, as they arrived: id, arrival, time at which the script took it, first number."""
        with self.lock:
            assert self.process.stdin is not None
            self.process.stdin.write(json.dumps([device, first]) + "\n")
            self.process.stdin.flush()
            log: list[list[float]] = json.loads(self._line())
        return log

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()


def gateway_of(ports: list[int], directory: str) -> tuple[Gateway, list[int]]:
    """A gateway of these devices, and its WSG ports."""
    own = [free_port() for _ in ports]
    text = "".join(
        f'[grippers.g{index}]\nurl = "tcp://127.0.0.1:{port}"\nstream_ids = [{STEER}]\nwsg_port = "127.0.0.1:{own[index]}"\n'
        for index, port in enumerate(ports)
    )
    file = Path(directory, "gateway.toml")
    file.write_text(text)
    gateway = Gateway("--config", str(file))
    gateway.start()
    return gateway, own


def steer(port: int, hz: float, jitter_s: float) -> None:
    """Steers until the process is killed. SIGUSR1 silences the client, SIGUSR2 lets it go on."""
    is_silent = False

    def silence(number: int, _: Any) -> None:
        nonlocal is_silent
        is_silent = number == signal.SIGUSR1

    signal.signal(signal.SIGUSR1, silence)
    signal.signal(signal.SIGUSR2, silence)
    driver, goal, insists_until = Driver(port), 0.0, 0.0
    print("steering", flush=True)
    due = time.monotonic()
    while True:
        due = max(due + 1 / hz, time.monotonic())
        time.sleep(max(0.0, due + random.uniform(0, jitter_s) - time.monotonic()))
        if is_silent:
            continue
        status, data = driver.ask(width(goal, 2))
        if status == SUCCESS:
            insists_until = 0.0
            at_mm = struct.unpack_from("<f", data, 1)[0]
            goal = 0.0 if at_mm > 80 else 110.0 if at_mm < 30 else goal
            continue
        assert status == ABORTED, status
        now = time.monotonic()
        insists_until = insists_until or now + INSISTS_S
        if now > insists_until:
            insists_until = 0.0
            time.sleep(PAUSES_S)


class Client:
    """A client in a process of its own."""

    def __init__(self, port: int, hz: float = 50, jitter_s: float = 0) -> None:
        program = [sys.executable, __file__, "client", str(port), str(hz), str(jitter_s)]
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "steering\n"

    def signal(self, number: int) -> None:
        assert self.process.poll() is None, "the client has ended"
        self.process.send_signal(number)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class Trials:
    """Trials of one gripper, one after another."""

    def __init__(self, devices: Devices, device: int, port: int) -> None:
        self.devices, self.device = devices, device
        self.client, self.other = Client(port), Driver(port)
        # Time from the device's last answer to the Stop, for each kind of trial.
        self.times: dict[str, list[float]] = {"frozen": [], "silent": [], "stopped": []}
        self.missing: list[str] = []
        # Stops of another client that a target waited for on the device. The script takes it after the Stop.
        self.overtaken = 0
        # Targets that came too early after a Stop: the kind of the trial, and their time in ms after the client went on.
        self.following: list[tuple[str, int]] = []

    def run(self, number: int) -> None:
        for kind in [kind for kind in self.times for _ in range(number)]:
            self.one(kind)

    def one(self, kind: str) -> None:
        first = len(self.devices.log(self.device))
        time.sleep(random.uniform(0.2, 0.7))
        if kind == "frozen":
            self.client.signal(signal.SIGSTOP)
        elif kind == "silent":
            self.client.signal(signal.SIGUSR1)
        else:
            assert self.other.ask(b"", STOP)[0] == SUCCESS
        if kind != "stopped":
            time.sleep(SILENCE_S + 0.3)
            resumed = time.monotonic()
            self.client.signal(signal.SIGCONT if kind == "frozen" else signal.SIGUSR2)
        # The stream begins anew after the client has insisted and paused.
        deadline = time.monotonic() + 10
        while not self.ended(log := self.devices.log(self.device, first)) and time.monotonic() < deadline:
            time.sleep(0.05)
        stop = next((index for index, entry in enumerate(log) if entry[0] == STOP), None)
        if stop is None or not self.ended(log):
            self.missing.append(kind)
            return
        stopped = log[stop][1]
        before = [entry for entry in log[:stop] if entry[0] == STEER]
        after = [entry for entry in log[stop:] if entry[0] == STEER]
        self.times[kind].append(stopped - before[-1][2] if before else 0.0)
        self.overtaken += kind == "stopped" and any(entry[0] == STEER and entry[2] > stopped for entry in log[:stop])
        begins = stopped if kind == "stopped" else resumed
        early = [entry[1] - begins for entry in after if entry[1] < begins + INSISTS_S + PAUSES_S - 0.1]
        self.following += [(kind, round(passed * 1000)) for passed in early]

    @staticmethod
    def ended(log: list[list[float]]) -> bool:
        stop = next((index for index, entry in enumerate(log) if entry[0] == STOP), len(log))
        return any(entry[0] == STEER for entry in log[stop:])


def stops(number: int, grippers: int, period_ms: int) -> bool:
    halves = [Devices(grippers // 2 + 1, period_ms / 1000) for _ in range(2)]
    places = [(half, device) for half in halves for device in range(grippers // 2 + 1)]
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as directory:
        gateway, ports = gateway_of([half.ports[device] for half, device in places], directory)
        # The last two steer as clients do whose network is bad: at 30 Hz, each target up to 100 ms late.
        healthy = [Client(port, 30, 0.1) for port in ports[-2:]]
        # All are ready before the first trial, which their start would delay.
        trials = [Trials(*place, port) for place, port in zip(places[:-2], ports, strict=False)]
        share = -(-number // len(trials))
        threads = [threading.Thread(target=each.run, args=(share,)) for each in trials]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            unasked = [entry for half, device in places[-2:] for entry in half.log(device) if entry[0] != STEER]
            targets = sum(len(half.log(device)) for half, device in places[-2:])
        finally:
            for client in [*healthy, *(each.client for each in trials)]:
                client.kill()
            for half in halves:
                half.kill()
            gateway.kill()
    print(f"{len(trials)} grippers, {time.monotonic() - started:.0f} s")
    is_right = True
    for kind in ("frozen", "silent"):
        times = sorted(found for each in trials for found in each.times[kind])
        late = [found for found in times if found > SILENCE_S + LATE_S]
        early = [found for found in times if found < SILENCE_S]
        print(
            f"{kind}: {len(times)} Stops, {min(times) * 1000:.1f} to {max(times) * 1000:.1f} ms after the last answer, "
            f"median {statistics.median(times) * 1000:.1f} ms; {len(early)} early, {len(late)} later than {LATE_S * 1000:.0f} ms"
        )
        # Other work on the machine delays some.
        is_right &= not early and len(late) <= len(times) / 100
    count = sum(len(each.times["stopped"]) for each in trials)
    following = [found for each in trials for found in each.following]
    missing = [kind for each in trials for kind in each.missing]
    overtaken = sum(each.overtaken for each in trials)
    print(f"stopped by another client: {count} times, {overtaken} of them while a target waited for the script; targets after any Stop: {following}; trials without a Stop: {missing}")
    print(f"healthy streams: {len(unasked)} Stops in {targets} targets")
    return is_right and not following and not missing and not unasked


def main() -> None:
    match sys.argv[1:]:
        case ["stops", *more]:
            number, grippers, period_ms = [int(value) for value in more] + [100, 20, 5][len(more) :]
            sys.exit(0 if stops(number, grippers, period_ms) else 1)
        case ["client", port, hz, jitter_s]:
            steer(int(port), float(hz), float(jitter_s))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
