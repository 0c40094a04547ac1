"""Kills the broker and the gateway under load: kills.py NUMBER. Afterwards the subscriber's table equals the journal.

The subscriber is the program of the guide. A second one notes the order in which records arrive.
"""

from __future__ import annotations

import json
import random
import sys
import threading
import time

import paho.mqtt.client as mqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from rig import SIMULATED, Broker, Gateway, Load, broker_section, compare, guide_subscriber, temporary_directory, until

PREFIX = "wsg/cell"
LISTS = ("events", "grips")


class Arrivals:
    """The numbers of the records in the order of their arrival."""

    def __init__(self, broker: Broker) -> None:
        self.numbers: dict[str, list[int]] = {name: [] for name in LISTS}
        self._lock = threading.Lock()
        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, "arrivals", protocol=mqtt.MQTTv5)
        client.on_message = self._received
        client.on_connect = lambda client, *_: client.subscribe(
            [(f"{PREFIX}/events", 1), (f"{PREFIX}/+/events", 1), (f"{PREFIX}/+/grips", 1)]
        )
        self.is_subscribed = threading.Event()
        client.on_subscribe = lambda *_: self.is_subscribed.set()
        client.reconnect_delay_set(1, 2)
        session = Properties(PacketTypes.CONNECT)
        session.SessionExpiryInterval = 86400
        client.connect("127.0.0.1", broker.port, clean_start=False, properties=session)
        client.loop_start()
        self._client = client

    def _received(self, _client: mqtt.Client, _data: object, message: mqtt.MQTTMessage) -> None:
        with self._lock:
            self.numbers[message.topic.rsplit("/", 1)[1]].append(json.loads(message.payload)["seq"])

    def end(self) -> dict[str, tuple[int, int]]:
        """Checks the order of first appearances, and returns the numbers of records and of repetitions."""
        self._client.loop_stop()
        result = {}
        for name, numbers in self.numbers.items():
            # Records from before the subscription can be among the repetitions.
            firsts = [number for number in dict.fromkeys(numbers) if number >= numbers[0]]
            wrong = [(one, other) for one, other in zip(firsts, firsts[1:]) if other != one + 1]
            assert not wrong, f"{name}: out of order or missing: {wrong[:5]}"
            result[name] = (len(firsts), len(numbers) - len(firsts))
        return result


def main() -> None:
    kills = int(sys.argv[1])
    with temporary_directory() as directory:
        broker = Broker(directory)
        gateway = Gateway(directory, [SIMULATED] * 4, broker_section(broker.url))
        try:
            with guide_subscriber(directory, broker, PREFIX) as database:
                until("the subscriber", database.exists)
                arrivals = Arrivals(broker)
                assert arrivals.is_subscribed.wait(30)
                # The subscriber of the guide has begun earlier.
                broker.save()
                load = Load(gateway, 0.05)
                begin = time.monotonic()
                for _ in range(kills):
                    time.sleep(random.uniform(0.3, 2))
                    broker.kill()
                    time.sleep(random.uniform(0, 0.5))
                    broker.start()
                    time.sleep(random.uniform(0.3, 2))
                    gateway.kill()
                    gateway.start()
                load.end()
                counts = compare(gateway, database)
                until("all arrivals", lambda: all(max(arrivals.numbers[name]) >= max(gateway.records(name)) for name in LISTS))
                print(f"{kills} kills of the broker and {kills} of the gateway in {time.monotonic() - begin:.0f} s")
                print(f"the table equals the journal: {counts}")
                print(f"records and repetitions that arrived, all in order: {arrivals.end()}")
            gateway.terminate()
        finally:
            gateway.kill()
            broker.kill()


main()
