"""Time from the device's final reply to a motion until a client of the WSG port has its result.

    python3 tests/bench/motion_end.py PROGRAM [OTHER_PROGRAM]

Each build serves a simulated device of its own, behind a tap that notes when the device's final reply passes. Motions
alternate between two builds, and between updates of 10 and 20 ms. The times include the delay of the tap.
"""

import asyncio
import os
import re
import struct
import sys
import time

HOME = 0x20
MOVE = 0x21
SUCCESS = 0
PENDING = 26
MOTIONS = 100


def table_entry(byte):
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


TABLE = [table_entry(byte) for byte in range(256)]


def request(command, payload):
    frame = b"\xaa\xaa\xaa" + struct.pack("<BH", command, len(payload)) + payload
    checksum = 0xFFFF
    for byte in frame:
        checksum = TABLE[(checksum ^ byte) & 0xFF] ^ checksum >> 8
    return frame + struct.pack("<H", checksum)


class Frames:
    """Finds the final replies to motions in a stream of frames."""

    def __init__(self):
        self.buffer = bytearray()

    def result(self, data):
        """Returns the status of the final reply in these bytes, if there is one."""
        self.buffer += data
        found = None
        while len(self.buffer) >= 8:
            size = struct.unpack_from("<H", self.buffer, 4)[0]
            if len(self.buffer) < 8 + size:
                break
            status = struct.unpack_from("<H", self.buffer, 6)[0]
            if self.buffer[3] in (HOME, MOVE) and status != PENDING:
                found = status
            del self.buffer[: 8 + size]
        return found


class Cell:
    """A build with its device and a client, and the times of its results in ms."""

    def __init__(self, program, period_ms):
        self.program = program
        self.period_ms = period_ms
        self.processes = []
        self.times = []
        self.replied_at = 0.0

    async def start(self, *arguments, before):
        environment = {**os.environ, "WSG_GATEWAY_JOURNAL": ":memory:", "WSG_GATEWAY_LOG": "info"}
        process = await asyncio.create_subprocess_exec(
            self.program, *arguments, env=environment, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        self.processes.append(process)
        while line := await process.stdout.readline():
            if found := re.search(before + r"tcp://[0-9.]+:([0-9]+)", line.decode()):
                asyncio.create_task(self.drain(process.stdout))
                return int(found[1])
        raise SystemExit(f"{self.program} prints no line with {before!r}")

    @staticmethod
    async def drain(output):
        while await output.readline():
            pass

    async def open(self, folder):
        self.device_port = await self.start("sim", "tcp://127.0.0.1:0", before=" at ")
        tap = await asyncio.start_server(self.tap, "127.0.0.1", 0)
        tapped = tap.sockets[0].getsockname()[1]
        path = os.path.join(folder, f"{id(self)}.toml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(f'listen = "127.0.0.1:0"\non_journal_failure = "continue"\n[grippers.g]\nurl = "tcp://127.0.0.1:{tapped}"\n')
            file.write(f'wsg_port = "127.0.0.1:0"\nupdate_period_ms = {self.period_ms}\n')
        port = await self.start("--config", path, "--zenoh-listen", "tcp/127.0.0.1:0", before="WSG port of g: ")
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", port)
        self.client = Frames()
        # Refused until the gripper is set up.
        while await self.run(request(HOME, b"\x00")) != SUCCESS:
            await asyncio.sleep(0.1)
        self.times.clear()

    async def tap(self, reader, writer):
        device_reader, device_writer = await asyncio.open_connection("127.0.0.1", self.device_port)
        asyncio.create_task(self.forward(reader, device_writer, None))
        await self.forward(device_reader, writer, Frames())

    async def forward(self, reader, writer, frames):
        while data := await reader.read(4096):
            writer.write(data)
            if frames and frames.result(data) is not None:
                self.replied_at = time.perf_counter()

    async def run(self, motion):
        self.writer.write(motion)
        while (status := self.client.result(await self.reader.read(4096))) is None:
            pass
        self.times.append((time.perf_counter() - self.replied_at) * 1000)
        return status

    def report(self):
        times = sorted(self.times)
        p50, p90 = (times[len(times) * percent // 100] for percent in (50, 90))
        print(f"{self.program}, updates of {self.period_ms} ms: p50 {p50:.2f} ms, p90 {p90:.2f} ms")

    async def close(self):
        for process in self.processes:
            process.kill()
            await process.wait()


async def main(programs, folder):
    cells = [Cell(program, period_ms) for period_ms in (10, 20) for program in programs]
    try:
        for cell in cells:
            await cell.open(folder)
        for number in range(MOTIONS):
            for cell in cells:
                width = 60.0 + number % 2 * 5
                status = await cell.run(request(MOVE, b"\x00" + struct.pack("<ff", width, 400.0)))
                if status != SUCCESS:
                    raise SystemExit(f"{cell.program}: motion {number} ended with the status {status}")
                # Ends at any time between two updates.
                await asyncio.sleep(number % 17 / 1000)
        for cell in cells:
            cell.report()
    finally:
        for cell in cells:
            await cell.close()


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(main(sys.argv[1:], folder))
