"""FAST STOPs over HTTP and the memory of the gateway beside a broker that misbehaves: faults.py SECONDS.

One is frozen, one accepts connections and never answers, and one is away. Before them, a broker that works.
"""

from __future__ import annotations

import http.client
import json
import os
import socket
import statistics
import sys
import threading
import time
from typing import Callable

from rig import Broker, Gateway, Load, temporary_directory, until

STOPPED = "g0"


class SilentBroker:
    """Accepts connections, and reads and sends nothing."""

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._held: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        try:
            while True:
                self._held.append(self._server.accept()[0])
        except OSError:
            return

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for held in self._held:
            held.close()


def resident_mb(gateway: Gateway) -> float:
    with open(f"/proc/{gateway.pid}/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def fast_stops(gateway: Gateway, seconds: float) -> list[float]:
    """Durations in ms of FAST STOPs on one connection, each confirmed and acknowledged."""
    connection = http.client.HTTPConnection("127.0.0.1", gateway.port)

    def post(path: str, body: object) -> tuple[float, dict]:
        begin = time.perf_counter()
        connection.request("POST", f"/api/v1/grippers/{STOPPED}/{path}", json.dumps(body))
        answer = connection.getresponse()
        text = answer.read()
        return (time.perf_counter() - begin) * 1000, json.loads(text)

    taken_ms = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        took_ms, stop = post("fast-stop", {})
        assert stop["fast_stop_confirmed"], stop
        taken_ms.append(took_ms)
        post("acknowledge", {"fast_stop_id": stop["fast_stop_id"]})
        time.sleep(0.02)
    return taken_ms


def main() -> None:
    seconds = float(sys.argv[1])
    with temporary_directory() as directory:
        broker = Broker(directory)
        gateway = Gateway(directory, broker, 5, "commands = true\nfast_stop = true\nstate_interval_ms = 20\ntelemetry_interval_ms = 20")
        until("all connections", lambda: gateway.metric("wsg_mqtt_connected") == 3)
        load = Load(gateway, 0)

        def measure(what: str) -> None:
            grips = load.grips
            taken_ms = fast_stops(gateway, seconds)
            quantiles = statistics.quantiles(taken_ms, n=100)
            print(f"{what}: FAST STOP {quantiles[49]:.1f} ms (median), {quantiles[98]:.1f} ms (p99), {max(taken_ms):.1f} ms "
                  f"(maximum of {len(taken_ms)}); {(load.grips - grips) / seconds * 60:.0f} grips a minute; "
                  f"{resident_mb(gateway):.0f} MB", flush=True)

        # The gripper that is stopped does not grip.
        faults: list[tuple[str, Callable[[], object]]] = []
        silent: list[SilentBroker] = []
        faults.append(("working broker", lambda: None))
        faults.append(("frozen broker", broker.freeze))
        faults.append(("no broker", lambda: (broker.thaw(), broker.kill())))
        faults.append(("silent broker", lambda: silent.append(SilentBroker(broker.port))))
        try:
            for what, begin in faults:
                begin()
                measure(what)
            silent[0].close()
            broker.start()
            until("nothing waiting", lambda: gateway.metric("wsg_mqtt_waiting_events") < 100, 300)
            load.end()
            gateway.terminate()
        finally:
            gateway.kill()
            broker.kill()


main()
