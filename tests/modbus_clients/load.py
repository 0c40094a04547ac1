"""Measures the processor time that cyclic reads over Modbus cost a running gateway, and their latency.

usage: tests/modbus_clients/load.py HOST:PORT PROCESS-ID-OF-THE-GATEWAY [CLIENTS [READS-PER-SECOND [SECONDS]]]
"""

import asyncio
import os
import struct
import sys
import time

host, port = sys.argv[1].rsplit(":", 1)
process = int(sys.argv[2])
clients, hz, seconds = [int(given) for given in sys.argv[3:]] + [32, 100, 10][len(sys.argv) - 3 :]

STATUS, REGISTERS = 100, 16
HEADER_BYTES = 9


def processor_s() -> float:
    """User and system time of the gateway so far."""
    with open(f"/proc/{process}/stat", encoding="ascii") as stat:
        fields = stat.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def poll(number: int, until: float, latencies: list[float]) -> None:
    """Reads the status registers of unit 1 like a cyclic program."""
    reader, writer = await asyncio.open_connection(host, int(port))
    request = struct.pack(">HHHBBHH", number, 0, 6, 1, 4, STATUS, REGISTERS)
    await asyncio.sleep(number / (clients * hz))
    due = time.monotonic()
    while (sent := time.monotonic()) < until:
        writer.write(request)
        await reader.readexactly(HEADER_BYTES + 2 * REGISTERS)
        latencies.append(time.monotonic() - sent)
        due += 1 / hz
        await asyncio.sleep(max(0.0, due - time.monotonic()))
    writer.close()


async def main() -> None:
    before = processor_s()
    await asyncio.sleep(seconds)
    idle = (processor_s() - before) / seconds
    latencies: list[float] = []
    before, begun = processor_s(), time.monotonic()
    await asyncio.gather(*(poll(number, begun + seconds, latencies) for number in range(clients)))
    took = time.monotonic() - begun
    loaded = (processor_s() - before) / took
    latencies.sort()
    p50, p99 = (latencies[int(len(latencies) * share)] * 1000 for share in (0.5, 0.99))
    print(
        f"{len(latencies) / took:.0f} reads/s cost {100 * (loaded - idle):.1f} % of a core ({100 * idle:.1f} % without "
        f"them); latency p50 {p50:.2f} ms, p99 {p99:.2f} ms"
    )


asyncio.run(main())
