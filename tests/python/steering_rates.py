"""Rate and age of targets at an independent script: direct, through a WSG port, and in servo sessions.

usage: steering_rates.py [SECONDS]      seconds for each way and rate, 20 by default

The ways take turns in blocks of two seconds, so that other work on the machine meets all of them. The age of a target is the
time from its sending, which includes the client's library, until the script takes it. Needs the packages websockets and
eclipse-zenoh.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from gateways import Gateway, free_port
from steered import STEER, SUCCESS, Driver, frame, gains, width
from steering import Devices
from websockets.sync.client import ClientConnection, connect

BLOCK_S = 2.0
# Time that a script takes for a request.
FAST_S, SLOW_S = 0.005, 0.025
# The fingers begin at 100 mm. A target is told by its width.
BEGIN_MM, STEP_MM = 99.0, 1 / 64
SPEED_MM_S = 10.0
ADAPTERS = {"position_pd": gains, "width_speed": width}
# Goals.
RATE, FACTOR, MARGIN_MS, OPEN_LOOP_MS = 0.98, 1.5, 0.2, 50.0


class Frames:
    """B1h of the gripper's protocol. Like public drivers, it waits for each reply, unless the loop is open."""

    def __init__(self, port: int, target: Callable[[float, float], bytes], is_open: bool) -> None:
        self.port, self.target, self.is_open = port, target, is_open

    def begin(self) -> None:
        self.driver = Driver(self.port)
        if self.is_open:
            threading.Thread(target=self._read, args=(self.driver,), daemon=True).start()

    def encoded(self, width_mm: float) -> bytes:
        return frame(STEER, self.target(width_mm, SPEED_MM_S))

    def send(self, target: bytes) -> None:
        self.driver.socket.sendall(target)
        if not self.is_open:
            command, data = self.driver.next()
            assert (command, data[:2]) == (STEER, SUCCESS.to_bytes(2, "little")), data

    def end(self) -> None:
        self.driver.send(b"", 0x07)
        if not self.is_open:
            assert self.driver.next()[0] == 0x07
            self.driver.socket.close()

    @staticmethod
    def _read(driver: Driver) -> None:
        """Reads all replies, so that the connection takes further targets."""
        with driver.socket:
            while driver.next()[0] != 0x07:
                pass


class Servo:
    """A servo session. Its targets get no answers."""

    def __init__(self, gripper: str, adapter: str) -> None:
        self.gripper = gripper
        self.terms: dict[str, Any] = {"adapter": adapter, "max_speed_mm_s": 100}
        if adapter == "position_pd":
            self.terms["force_n"] = 40

    def begin(self) -> None:
        self.call("servo.start", self.terms)

    def end(self) -> None:
        report = self.call("servo.stop", {})
        assert report["refused"] == 0, report

    def call(self, method: str, fields: dict[str, Any]) -> dict[str, Any]:
        raise NotImplementedError


class ServoOverWebSocket(Servo):
    def __init__(self, socket: ClientConnection, gripper: str, adapter: str) -> None:
        super().__init__(gripper, adapter)
        self.socket = socket

    def encoded(self, width_mm: float) -> str:
        params = {"gripper": self.gripper, "width_mm": width_mm}
        return json.dumps({"jsonrpc": "2.0", "method": "servo.target", "params": params})

    def send(self, target: str) -> None:
        self.socket.send(target)

    def call(self, method: str, fields: dict[str, Any]) -> dict[str, Any]:
        self.socket.send(json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": {"gripper": self.gripper, **fields}}))
        while True:
            answer: dict[str, Any] = json.loads(self.socket.recv(timeout=10))
            if answer.get("id") == 1:
                result: dict[str, Any] = answer["result"]
                return result


class ServoOverZenoh(Servo):
    def __init__(self, session: zenoh.Session, gripper: str, adapter: str) -> None:
        super().__init__(gripper, adapter)
        self.session, self.key = session, f"wsg/v1/gateway/{gripper}/command"
        self.publisher = session.declare_publisher(f"{self.key}/servo.target")

    def encoded(self, width_mm: float) -> str:
        return json.dumps({"width_mm": width_mm, "client": "rates"})

    def send(self, target: str) -> None:
        self.publisher.put(target)

    def call(self, method: str, fields: dict[str, Any]) -> dict[str, Any]:
        replies = self.session.get(f"{self.key}/{method}?client=rates", payload=json.dumps(fields), timeout=10.0)
        reply = next(iter(replies))
        assert reply.ok is not None, reply.err and reply.err.payload.to_string()
        result: dict[str, Any] = json.loads(reply.ok.payload.to_string())
        return result


class Found:
    """Targets of one way at one rate."""

    def __init__(self) -> None:
        self.sent = 0
        self.ages_ms: list[float] = []
        # Age of the last target of each block, which counts for itself: no newer one replaces it, so it waits until the
        # script has taken the one before.
        self.last_ms: list[float] = []
        # Seconds that the targets would take at the rate of the client, and that they took.
        self.planned_s, self.took_s = 0.0, 0.0

    def rate(self) -> float:
        """Applied targets per second, compared with the rate of the client."""
        return len(self.ages_ms) / self.sent * self.planned_s / self.took_s

    def age_ms(self, share: float) -> float:
        return sorted(self.ages_ms)[min(int(len(self.ages_ms) * share), len(self.ages_ms) - 1)]


class Place(NamedTuple):
    """A way to a device: the client, and the number of the device."""

    client: Any
    device: int


def block(place: Place, devices: Devices, hz: float, found: Found) -> None:
    """Sends targets for a block, and adds what the script took."""
    client, number = place
    first = len(devices.log(number))
    first_targets, count = round(hz / 5), round(hz * BLOCK_S)
    sent: dict[float, float] = {}

    def send(number: int) -> None:
        # The fingers reach the first width, which does not count. Each other is that of one target.
        step = number + 1 - first_targets
        width_mm = BEGIN_MM - max(0, step) * STEP_MM
        target = client.encoded(width_mm)
        if step > 0:
            sent[width_mm] = time.monotonic()
        client.send(target)

    client.begin()
    paced(hz, first_targets + count + 1, send)
    # The slow script takes the last one.
    time.sleep(0.06)
    client.end()
    # The first time counts, should a target be repeated.
    taken = {entry[3]: entry[2] for entry in reversed(devices.log(number, first)) if entry[0] == STEER and entry[2]}
    times = list(sent.values())
    found.planned_s += count / hz
    found.took_s += times[-1] - times[0]
    last_mm, last_at = sent.popitem()
    found.last_ms += [(taken[last_mm] - last_at) * 1000] if last_mm in taken else []
    found.sent += count
    found.ages_ms += [(taken[width_mm] - at) * 1000 for width_mm, at in sent.items() if width_mm in taken]
    # Direct, the slow script still has targets of an open loop.
    time.sleep(0.04)


def paced(hz: float, count: int, act: Callable[[int], None]) -> None:
    """Calls `act` at a rate. After a late call, the next is not due at once, so that targets do not meet at the script."""
    due = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, due - time.monotonic()))
        act(number)
        due = max(due + 1 / hz, time.monotonic() + 0.8 / hz)


def measure(ways: dict[str, Place], devices: Devices, hz: float, seconds: float) -> dict[str, Found]:
    found = {name: Found() for name in ways}
    for number in range(max(1, round(seconds / BLOCK_S))):
        # In turns from both ends, so that no way always follows the same one.
        for name in list(ways)[:: 1 if number % 2 else -1]:
            block(ways[name], devices, hz, found[name])
    return found


def show(title: str, found: dict[str, Found], goal: Callable[[Found, Found], bool]) -> bool:
    direct = found["direct"]
    is_right = True
    for name, each in found.items():
        ages = " ".join(f"{word} {each.age_ms(share):.2f} ({each.age_ms(share) / direct.age_ms(share):.2f})" for word, share in (("p50", 0.5), ("p99", 0.99)))
        last_ms = f"{max(each.last_ms):.2f}" if each.last_ms else "-"
        holds = name == "direct" or goal(each, direct)
        is_right &= holds
        verdict = "" if name == "direct" else "goal holds" if holds else "goal MISSED"
        print(f"{title:24} {name:9} {len(each.ages_ms):5} of {each.sent:5}, rate {each.rate():.3f}, {ages}, most {max(each.ages_ms):.2f}, last {last_ms} {verdict}")
    sys.stdout.flush()
    return is_right


def is_fresh(found: Found, direct: Found) -> bool:
    ages = all(found.age_ms(share) <= FACTOR * direct.age_ms(share) + MARGIN_MS for share in (0.5, 0.99))
    return ages and found.rate() >= RATE


def is_newest(found: Found, _: Found) -> bool:
    return max(found.ages_ms) <= OPEN_LOOP_MS


def gateway_of(ports: dict[str, int], directory: str, endpoint: str) -> tuple[Gateway, dict[str, int]]:
    """A gateway of these devices, and its WSG ports."""
    own = {name: free_port() for name in ports}
    section = '[grippers.{}]\nurl = "tcp://127.0.0.1:{}"\nservo_adapter = "position_pd"\nstream_ids = [{}]\nwsg_port = "127.0.0.1:{}"\n'
    file = Path(directory, "gateway.toml")
    file.write_text("".join(section.format(name, port, STEER, own[name]) for name, port in ports.items()))
    gateway = Gateway("--config", str(file), zenoh=endpoint)
    gateway.start()
    return gateway, own


def zenoh_session(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def run(seconds: float) -> bool:
    """Each script of a pair is steered directly or by the gateway."""
    fast, slow = Devices(2, FAST_S), Devices(2, SLOW_S)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    is_right = True
    print(f"load {os.getloadavg()[0]:.1f}; ages in ms, and compared with direct in the same run", flush=True)
    with tempfile.TemporaryDirectory() as directory:
        gateway, ports = gateway_of({"fast": fast.ports[1], "slow": slow.ports[1]}, directory, endpoint)
        try:
            with (
                zenoh_session(endpoint) as session,
                connect(f"ws://127.0.0.1:{gateway.port}/api/v1/ws", subprotocols=["wsg.v1"], compression=None) as socket,  # type: ignore[list-item]
            ):

                def ways(gripper: str, direct: int, adapter: str, is_open: bool) -> dict[str, Place]:
                    target = ADAPTERS[adapter]
                    return {
                        "direct": Place(Frames(direct, target, is_open), 0),
                        "WSG port": Place(Frames(ports[gripper], target, is_open), 1),
                        "WebSocket": Place(ServoOverWebSocket(socket, gripper, adapter), 1),
                        "Zenoh": Place(ServoOverZenoh(session, gripper, adapter), 1),
                    }

                for adapter, hz in itertools.product(ADAPTERS, (30, 50, 100)):
                    found = measure(ways("fast", fast.ports[0], adapter, is_open=False), fast, hz, seconds)
                    is_right &= show(f"{adapter}, {hz} Hz", found, is_fresh)
                found = measure(ways("slow", slow.ports[0], "position_pd", is_open=True), slow, 100, seconds / 2)
                is_right &= show("open loop, 100 Hz, 25 ms", found, is_newest)
        finally:
            fast.kill()
            slow.kill()
            gateway.kill()
    print(f"load {os.getloadavg()[0]:.1f}")
    return is_right


if __name__ == "__main__":
    sys.exit(0 if run(float(sys.argv[1]) if len(sys.argv) > 1 else 20) else 1)
