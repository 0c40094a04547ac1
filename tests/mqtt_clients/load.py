"""Processor time of the gateway, and delays until a subscriber has the records: load.py SECONDS GRIPPERS GRIPS-A-MINUTE.

The simulated grippers are a process of their own. Before MQTT is measured, the same load runs without it for a fifth of
the time. The subscriber of the guide fills its table, which then equals the journal. Another one, in a process of its
own, notes when it got each record.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path

import paho.mqtt.client as mqtt

from rig import Broker, Gateway, Load, Simulators, broker_section, compare, guide_subscriber, temporary_directory, until

PREFIX = "wsg/cell"


def note_receipts(port: int, file: Path) -> None:
    """Appends list, number and time of each record to a file, until the process is killed."""
    with open(file, "w", encoding="utf-8", buffering=1) as receipts:

        def received(_client: mqtt.Client, _data: object, message: mqtt.MQTTMessage) -> None:
            now = time.time()
            name = message.topic.rsplit("/", 1)[1]
            receipts.write(f"{name} {json.loads(message.payload)['seq']} {now}\n")

        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        client.on_message = received
        client.on_connect = lambda client, *_: client.subscribe(
            [(f"{PREFIX}/events", 1), (f"{PREFIX}/+/events", 1), (f"{PREFIX}/+/grips", 1)]
        )
        client.on_subscribe = lambda *_: receipts.write("subscribed 0 0\n")
        client.connect("127.0.0.1", port)
        client.loop_forever()


def first_receipts(file: Path) -> dict[tuple[str, int], float]:
    """Time of the first receipt of each record."""
    receipts: dict[tuple[str, int], float] = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        name, seq, at = line.split()
        receipts.setdefault((name, int(seq)), float(at))
    return receipts


def seconds_of(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def shown(delays_ms: list[float]) -> str:
    quantiles = statistics.quantiles(delays_ms, n=1000, method="inclusive")
    return (f"{quantiles[499]:.1f} ms (p50), {quantiles[989]:.1f} ms (p99), {quantiles[998]:.1f} ms (p99.9), "
            f"{max(delays_ms):.1f} ms (maximum of {len(delays_ms)})")


def cost(gateway: Gateway, load: Load, seconds: float) -> str:
    """Measures for a time, once the grippers are homed."""
    until("the first grips", lambda: load.grips >= len(gateway.names))
    grips, used_s, begin = load.grips, gateway.processor_s(), time.monotonic()
    time.sleep(seconds)
    took_s = time.monotonic() - begin
    used_s = gateway.processor_s() - used_s
    grips = load.grips - grips
    return (f"{grips} grips in {took_s:.0f} s, {grips / took_s * 60:.0f} a minute; processor time of the gateway "
            f"{used_s:.1f} s, {used_s / took_s * 100:.1f} % of a core; at most {gateway.peak_mb():.0f} MB")


def main() -> None:
    seconds, grippers, grips_a_minute = (float(argument) for argument in sys.argv[1:4])
    with temporary_directory() as directory:
        simulators = Simulators(directory, int(grippers))
        broker = Broker(directory)
        started: list[Gateway] = []

        def start(name: str, mqtt_section: str) -> tuple[Gateway, Load]:
            started.append(Gateway(directory / name, simulators.urls, mqtt_section))
            return started[-1], Load(started[-1], grips_a_minute=grips_a_minute)

        receipts = directory / "receipts"
        noting = subprocess.Popen([sys.executable, __file__, "receipts", str(broker.port), str(receipts)])
        try:
            until("the subscriber", lambda: receipts.exists() and "subscribed" in receipts.read_text(encoding="utf-8"))
            gateway, load = start("without", "")
            print("without MQTT:", cost(gateway, load, seconds / 5), flush=True)
            load.end()
            gateway.terminate()
            with guide_subscriber(directory, broker, PREFIX) as database:
                until("the table", database.exists)
                gateway, load = start("with", broker_section(broker.url))
                print("with MQTT:", cost(gateway, load, seconds), flush=True)
                load.end()
                counts = compare(gateway, database)
            print(f"the table of the guide's subscriber equals the journal: {counts}")
            until("nothing waiting", lambda: gateway.metric("wsg_mqtt_waiting_events") == 0)
            grips = gateway.records("grips")
            events = gateway.records("events")
            until("all receipts", lambda: ("grips", max(grips)) in first_receipts(receipts))
            at = first_receipts(receipts)
            oldest = min(seq for name, seq in at if name == "events")
            events = {seq: event for seq, event in events.items() if seq >= oldest}
            missing = [("events", seq) for seq in events if ("events", seq) not in at]
            missing += [("grips", seq) for seq in grips if ("grips", seq) not in at]
            assert not missing, missing[:5]
            delays_ms = [(at["events", seq] - seconds_of(event["at"])) * 1000 for seq, event in events.items()]
            print("events at the subscriber after their time in the journal:", shown(delays_ms))
            held = {seq: record for seq, record in grips.items() if record["kind"] == "grip"}
            assert len(held) == load.grips, (len(held), load.grips)
            ended = {seq: seconds_of(record["started_at"]) + record["duration_ms"] / 1000 for seq, record in held.items()}
            delays_ms = [(at["grips", seq] - end) * 1000 for seq, end in ended.items()]
            print("grip records at the subscriber after the end of the grip:", shown(delays_ms))
            gateway.terminate()
        finally:
            noting.kill()
            for gateway in started:
                gateway.kill()
            broker.kill()
            simulators.kill()


if sys.argv[1] == "receipts":
    note_receipts(int(sys.argv[2]), Path(sys.argv[3]))
else:
    main()
