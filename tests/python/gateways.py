"""Gateways, simulated grippers and a proxy that counts motions, as processes and threads of the tests."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import struct
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
PROGRAM = os.environ.get("WSG_GATEWAY_PROGRAM", "target/debug/wsg-gateway")
# Ids of the motions in the gripper's protocol. Each but homing begins with a width or a speed.
MOTIONS = {0x20: "home", 0x21: "move", 0x25: "grip", 0x26: "release"}


def until(found: Callable[[], T], timeout_s: float = 30.0) -> T:
    """Waits for a true value, and returns it. A gateway that does not answer yet has none."""
    deadline = time.monotonic() + timeout_s
    while True:
        with contextlib.suppress(OSError):
            if value := found():
                return value
        assert time.monotonic() < deadline, "not within the time"
        time.sleep(0.01)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


class Process:
    """A process that can be killed, frozen and started again."""

    def __init__(self, *arguments: str) -> None:
        self.arguments = arguments
        self.log = tempfile.TemporaryFile("w+")
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("WSG_GATEWAY")}
        self.process = subprocess.Popen(
            [PROGRAM, *self.arguments], stdout=subprocess.PIPE, stderr=self.log, env=environment, text=True
        )

    def line(self, pattern: str) -> str:
        """Waits for a line of the output."""
        assert self.process is not None and self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.search(pattern, line):
                return found[1]
        self.log.seek(0)
        raise AssertionError(f"{self.arguments} has ended: {self.log.read()[-2000:]}")

    def signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.process = None


class Gateway(Process):
    """A gateway that keeps its port, and its journal if that is a file. It is on Zenoh if an endpoint is given."""

    def __init__(self, *arguments: str, journal: str = ":memory:", scheme: str = "http", port: int = 0, zenoh: str = "") -> None:
        self.port, self.zenoh = port or free_port(), zenoh
        self.url = f"{scheme}://127.0.0.1:{self.port}"
        flags = ["--listen", f"127.0.0.1:{self.port}"] if scheme == "http" else []
        network = ["--zenoh-listen", zenoh] if zenoh else ["--zenoh-mode", "off"]
        super().__init__(*arguments, *flags, *network, "--journal", journal)

    def start(self) -> None:
        super().start()
        self.line(r"(serves \w+ at)")
        assert self.process is not None
        # The rest of the output must not fill the pipe.
        threading.Thread(target=self.process.stdout.read, daemon=True).start()  # type: ignore[union-attr]
        if self.url.startswith("http:"):
            until(lambda: all(gripper["link"] == "connected" for gripper in self.get("/grippers")["grippers"]))

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"{self.url}/api/v1{path}", timeout=10) as response:
            return json.load(response)

    def post(self, path: str, **fields: Any) -> Any:
        request = urllib.request.Request(f"{self.url}/api/v1{path}", json.dumps(fields).encode(), method="POST")
        with urllib.request.urlopen(request, timeout=70) as response:
            return json.load(response)

    def state(self, gripper: str = "left") -> Any:
        return self.get(f"/grippers/{gripper}/state")

    def acknowledge(self, gripper: str = "left") -> None:
        """Acknowledges a FAST STOP, as a person does after looking at the gripper."""
        state = until(lambda: (now := self.state(gripper)).get("fast_stop_confirmed") and now)
        self.post(f"/grippers/{gripper}/acknowledge", fast_stop_id=state["fast_stop_id"])


class Device(Process):
    """A simulated gripper in a process of its own, which outlives the gateway."""

    def __init__(self, *options: str, part_mm: float | None = 20) -> None:
        self.port, self.control = free_port(), free_port()
        part = [] if part_mm is None else ["--part-mm", str(part_mm)]
        flags = [f for option in options for f in ("--option", option)]
        super().__init__("sim", f"tcp://127.0.0.1:{self.port}", *part, *flags, "--control", f"127.0.0.1:{self.control}")

    def start(self) -> None:
        super().start()
        self.line("(fault injection)")

    def state(self) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.control}/devices", timeout=10) as response:
            return json.load(response)[0]


class Proxy:
    """Forwards connections. `watch` sees all bytes of the client, and decides whether they go on."""

    def __init__(self, target: int, watch: Callable[[bytes], bool] = lambda _: True) -> None:
        self.target, self.watch = target, watch
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.server.getsockname()[1])
        self.open: list[socket.socket] = []
        self.is_silent_back = False
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Ends all connections."""
        self.is_silent_back = False
        ended, self.open = self.open, []
        for one in ended:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def drop_next(self) -> None:
        """Loses the next bytes of a client, and ends all connections with them."""

        def lose(_: bytes) -> bool:
            self.watch = lambda _: True
            self.cut()
            return False

        self.watch = lose

    def close(self) -> None:
        self.server.close()
        self.cut()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self.server.accept()
            except OSError:
                return
            try:
                device = socket.create_connection(("127.0.0.1", self.target), timeout=5)
            except OSError:
                client.close()
                continue
            device.settimeout(None)
            for one in (client, device):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.open += [client, device]
            threading.Thread(target=self._pump, args=(client, device, lambda data: self.watch(data)), daemon=True).start()
            threading.Thread(target=self._pump, args=(device, client, lambda _: not self.is_silent_back), daemon=True).start()

    @staticmethod
    def _pump(source: socket.socket, sink: socket.socket, watch: Callable[[bytes], bool]) -> None:
        try:
            while data := source.recv(65536):
                if watch(data):
                    sink.sendall(data)
        except OSError:
            pass
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


class MotionCounter(Proxy):
    """A proxy before a device, which notes each motion frame with its width: the device sees exactly these."""

    def __init__(self, target: int) -> None:
        self.motions: list[tuple[str, float]] = []
        self._rest = b""
        super().__init__(target, self._note)

    def grips(self) -> int:
        """Number of grips that the device has received."""
        return sum(kind == "grip" for kind, _ in self.motions)

    def _note(self, data: bytes) -> bool:
        # A new connection begins with a preamble, which also ends what an old one left.
        self._rest += data
        while (start := self._rest.find(b"\xaa\xaa\xaa")) >= 0 and len(self._rest) >= start + 6:
            number, size = self._rest[start + 3], int.from_bytes(self._rest[start + 4 : start + 6], "little")
            end = start + 6 + size + 2
            if len(self._rest) < end:
                break
            payload, self._rest = self._rest[start + 6 : start + 6 + size], self._rest[end:]
            if number in MOTIONS:
                offset = 1 if number == 0x21 else 0
                width = struct.unpack_from("<f", payload, offset)[0] if number != 0x20 else 0.0
                self.motions.append((MOTIONS[number], round(width, 3)))
        return True


@contextlib.contextmanager
def running(*processes: Process) -> Iterator[None]:
    """Starts processes, and kills them at the end."""
    try:
        for process in processes:
            process.start()
        yield
    finally:
        for process in processes:
            process.kill()


def freeze(process: Process) -> None:
    process.signal(signal.SIGSTOP)


def thaw(process: Process) -> None:
    process.signal(signal.SIGCONT)


def token(configuration: Path, name: str, role: str) -> str:
    """Creates a token."""
    command = [PROGRAM, "token", "create", "--config", str(configuration), "--name", name, "--role", role, "--expires", "never"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
