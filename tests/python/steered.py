"""A gripper with a script that steers its fingers, independent of the simulator, and clients that steer it.

The fingers move by the clock, towards the newest target. The device records each request of the script with the time of
its arrival and the time at which the script took it. All times are of the clock that processes share.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
import sys
import time
from collections import deque
from typing import Any

STOP, FAST_STOP, STEER = 0x22, 0x23, 0xB1
SUCCESS, ABORTED = 0, 19
REFERENCED, MOVING = 0x1, 0x2
STROKE_MM = 110.0
HEAD = struct.Struct("<3sBH")
CRC = [0] * 256
for index in range(256):
    entry = index << 8
    for _ in range(8):
        entry = (entry << 1 ^ 0x1021 if entry & 0x8000 else entry << 1) & 0xFFFF
    CRC[index] = entry


def frame(command: int, payload: bytes) -> bytes:
    body = HEAD.pack(b"\xaa\xaa\xaa", command, len(payload)) + payload
    crc = 0xFFFF
    for byte in body:
        crc = CRC[(crc ^ byte) & 0xFF] ^ crc >> 8
    return body + crc.to_bytes(2, "little")


def split(received: bytearray) -> list[tuple[int, bytes]]:
    """Takes the whole frames from the beginning of the received bytes."""
    found = []
    while len(received) >= HEAD.size:
        _, command, size = HEAD.unpack_from(received)
        end = HEAD.size + size + 2
        if len(received) < end:
            break
        found.append((command, bytes(received[HEAD.size : end - 2])))
        del received[:end]
    return found


def success(*values: float) -> bytes:
    return b"\0\0" + struct.pack(f"<{len(values)}f", *values)


# Replies of an idle WSG 50.
REPLIES = {
    0x07: success(),
    0x23: success(),
    0x24: success(),
    0x32: success(),
    0x33: success(80),
    0x35: b"\1\0",
    0x41: b"\0\0\0",
    0x45: success(0),
    0x46: b"\0\0\xfa\0",
    0x50: bytes([0, 0, 1, 6, 0x20, 0x40, 0x67, 0x12, 0, 0]),
    0x52: b"\1\0",
    0x53: success(110, 5, 420, 100, 5000, 5, 80, 120),
    STOP: success(),
}


class Device:
    """Serves one client at a time."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.from_mm, self.since, self.target_mm, self.speed_mm_s = 100.0, 0.0, 100.0, 0.0
        # Requests of the script and Stops, as they arrived: id, arrival, time at which the script took it, first number.
        self.log: list[list[float]] = []
        self.waiting: deque[tuple[list[float], bytes]] = deque()
        self.free_at = 0.0
        self.periods: dict[int, float] = {}

    def width_mm(self) -> float:
        way_mm = self.speed_mm_s * (time.monotonic() - self.since)
        return self.from_mm + max(-way_mm, min(way_mm, self.target_mm - self.from_mm))

    def velocity_mm_s(self) -> float:
        distance_mm = self.target_mm - self.width_mm()
        return 0.0 if abs(distance_mm) < 0.001 else self.speed_mm_s if distance_mm > 0 else -self.speed_mm_s

    def move(self, target_mm: float, speed_mm_s: float) -> None:
        self.from_mm, self.since = self.width_mm(), time.monotonic()
        self.target_mm, self.speed_mm_s = max(0.0, min(STROKE_MM, target_mm)), abs(speed_mm_s)

    def flags(self) -> int:
        return REFERENCED | (MOVING if self.velocity_mm_s() else 0)

    def steer(self, payload: bytes) -> bytes:
        """Width and speed in 9 bytes, or position, speed, gains and force limits in 25."""
        values = struct.unpack(f"<{len(payload) // 4}f", payload[1:])
        if len(values) == 2:
            self.move(*values)
        else:
            position_mm, speed_mm_s, kp, kd = values[:4]
            velocity_mm_s = kp * (position_mm - self.width_mm()) + kd * (speed_mm_s - self.velocity_mm_s())
            self.move(0 if velocity_mm_s < 0 else STROKE_MM, velocity_mm_s)
        state = struct.pack("<Bff", self.flags(), self.width_mm(), self.velocity_mm_s())
        return b"\0\0" + state.ljust(21 if len(values) == 2 else 17, b"\0")

    def reply(self, command: int, payload: bytes) -> bytes:
        if command == 0x40:
            data = b"\0\0" + self.flags().to_bytes(4, "little")
        elif command == 0x43:
            data = success(self.width_mm())
        elif command == 0x44:
            data = success(self.velocity_mm_s())
        elif command == 0x06:
            data = b"\0\0" + payload
        else:
            data = REPLIES.get(command, b"\x0e\0")
        return frame(command, data)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.waiting.clear()
        self.periods.clear()
        updates = asyncio.create_task(self.update(writer))
        received = bytearray()
        # A frozen or killed client ends its connection in any way.
        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                now = time.monotonic()
                received += data
                for command, payload in split(received):
                    self.take(command, payload, now, writer)
        updates.cancel()
        writer.close()

    def take(self, command: int, payload: bytes, now: float, writer: asyncio.StreamWriter) -> None:
        if command == STEER:
            self.log.append([command, now, 0.0, struct.unpack_from("<f", payload, 1)[0]])
            self.waiting.append((self.log[-1], payload))
            if len(self.waiting) == 1:
                asyncio.get_running_loop().call_later(max(0.0, self.free_at - now), self.run, writer)
            return
        if command in (STOP, FAST_STOP):
            self.move(self.width_mm(), 0)
            self.log.append([command, now, now, 0.0])
        if 0x40 <= command <= 0x45 and payload and payload[0] & 1:
            self.periods[command] = max(0.01, int.from_bytes(payload[1:3], "little") / 1000)
        writer.write(self.reply(command, payload))

    def run(self, writer: asyncio.StreamWriter) -> None:
        """Runs the script for the oldest request."""
        # A client that has left gets no replies.
        if not self.waiting or writer.is_closing():
            return
        entry, payload = self.waiting.popleft()
        now = entry[2] = time.monotonic()
        writer.write(frame(STEER, self.steer(payload)))
        self.free_at = now + self.period_s
        if self.waiting:
            asyncio.get_running_loop().call_later(self.period_s, self.run, writer)

    async def update(self, writer: asyncio.StreamWriter) -> None:
        """Sends automatic updates, all of one period at once."""
        sent: dict[int, float] = {}
        while True:
            await asyncio.sleep(0.01)
            now = time.monotonic()
            for command, period_s in self.periods.items():
                if now >= sent.get(command, 0.0) + period_s - 0.002:
                    sent[command] = now
                    writer.write(self.reply(command, b""))


async def serve_devices(count: int, period_s: float) -> None:
    """Serves devices. Prints their ports, and answers each line of the input with the log of the device it names."""
    devices, ports = [], []
    for _ in range(count):
        device = Device(period_s)
        server = await asyncio.start_server(device.serve, "127.0.0.1", 0)
        devices.append(device)
        ports.append(server.sockets[0].getsockname()[1])
    print(json.dumps(ports), flush=True)
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        device, first = devices[(asked := json.loads(line))[0]], asked[1]
        print(json.dumps(device.log[first:]), flush=True)


class Driver:
    """A client of the gripper's protocol that waits for each reply, like public drivers."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.received = bytearray()
        self.frames: deque[tuple[int, bytes]] = deque()

    def send(self, payload: bytes, command: int = STEER) -> None:
        self.socket.sendall(frame(command, payload))

    def next(self) -> tuple[int, bytes]:
        while not self.frames:
            data = self.socket.recv(4096)
            assert data, "the connection has ended"
            self.received += data
            self.frames.extend(split(self.received))
        return self.frames.popleft()

    def ask(self, payload: bytes, command: int = STEER) -> tuple[int, bytes]:
        """Sends a request, and returns the status and the data of the reply."""
        self.send(payload, command)
        answered, data = self.next()
        assert answered == command
        return int.from_bytes(data[:2], "little"), data[2:]


def width(width_mm: float, speed_mm_s: float) -> bytes:
    return b"\0" + struct.pack("<ff", width_mm, speed_mm_s)


def gains(width_mm: float, speed_mm_s: float) -> bytes:
    return b"\0" + struct.pack("<6f", width_mm, speed_mm_s, 0.05, 0.001, 80, 80)


if __name__ == "__main__":
    arguments: list[Any] = sys.argv[1:]
    asyncio.run(serve_devices(int(arguments[0]), float(arguments[1])))
