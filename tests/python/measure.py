"""Measures reads: their cost, and the age of the values at 50 reads per second while the fingers move.

usage: measure.py [SECONDS]
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time

import wsg_gateway
from gateways import Device, Gateway, running


def ages(left: wsg_gateway.Gripper, seconds: float) -> list[float]:
    """The ages of the width, read 50 times a second."""
    found, started = [], time.monotonic()
    while time.monotonic() - started < seconds:
        assert left.width_mm is not None
        found.append(left.age or 0)
        time.sleep(0.02)
    return sorted(found)


def show(title: str, values: list[float], unit: float, name: str) -> None:
    p50, p99 = (values[int(len(values) * share)] * unit for share in (0.5, 0.99))
    print(f"{title}: {len(values)} values, p50 {p50:.2f} {name}, p99 {p99:.2f} {name}, largest {values[-1] * unit:.2f} {name}")


def main() -> None:
    seconds = float(sys.argv[1]) if sys.argv[1:] else 20
    device = Device(part_mm=None)
    gateway = Gateway("--gripper", f"left=tcp://127.0.0.1:{device.port}")
    with running(device, gateway), wsg_gateway.connect(gateway.url) as client:
        left = client["left"]
        with left.control() as gripper:
            gripper.home()
            before = next(client._core.main._ids)
            runs = []
            for _ in range(20):
                started = time.perf_counter()
                for _ in range(10_000):
                    _ = left.width_mm
                runs.append((time.perf_counter() - started) / 10_000)
            print(f"requests during 200,000 reads: {next(client._core.main._ids) - before - 1}")
            show("one read", sorted(runs), 1e9, "ns")
            is_over = threading.Event()

            def move() -> None:
                while not is_over.is_set():
                    with contextlib.suppress(wsg_gateway.Refused):  # during a FAST STOP
                        gripper.move(20, 40)
                        gripper.move(100, 40)

            thread = threading.Thread(target=move)
            thread.start()
            show("age while the fingers move", ages(left, seconds), 1e3, "ms")
            stops = []
            for _ in range(20):
                started = time.perf_counter()
                stop = client.fast_stop("measurement")
                stops.append(time.perf_counter() - started)
                left.wait_for(lambda state, id=stop.id: state.fast_stop_confirmed and state.fast_stop_id == id, 2)
                left.acknowledge(stop.id)
                time.sleep(0.1)
            is_over.set()
            thread.join()
        time.sleep(1)
        show("age while nothing changes", ages(left, seconds / 2), 1e3, "ms")
        show("FAST STOP, until the gripper confirmed it", sorted(stops), 1e3, "ms")


if __name__ == "__main__":
    main()
