"""Grips for a number of seconds: load.py SECONDS GRIPPERS. Prints processor time, and the delay until a subscriber has each
record."""

from __future__ import annotations

import json
import statistics
import sys
import time
from datetime import datetime

import paho.mqtt.client as mqtt

from rig import Broker, Gateway, Load, temporary_directory, until

PREFIX = "wsg/cell"


def main() -> None:
    seconds, grippers = float(sys.argv[1]), int(sys.argv[2])
    with temporary_directory() as directory:
        broker = Broker(directory)
        gateway = Gateway(directory, broker, grippers)
        delays_ms: list[float] = []

        def received(_client: mqtt.Client, _data: object, message: mqtt.MQTTMessage) -> None:
            record = json.loads(message.payload)
            if record.get("kind") == "command":
                written = datetime.fromisoformat(record["at"]).timestamp()
                delays_ms.append((time.time() - written) * 1000)

        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        client.on_message = received
        client.on_connect = lambda client, *_: client.subscribe(f"{PREFIX}/+/events", 1)
        client.connect("127.0.0.1", broker.port)
        client.loop_start()
        try:
            load = Load(gateway, 0)
            time.sleep(3)
            delays_ms.clear()
            grips, used_s, begin = load.grips, gateway.processor_s(), time.monotonic()
            messages = gateway.metric("wsg_mqtt_messages_total")
            time.sleep(seconds)
            took_s = time.monotonic() - begin
            grips = load.grips - grips
            used_s = gateway.processor_s() - used_s
            messages = gateway.metric("wsg_mqtt_messages_total") - messages
            load.end()
            until("nothing waiting", lambda: gateway.metric("wsg_mqtt_waiting_events") == 0)
            quantiles = statistics.quantiles(delays_ms, n=100)
            print(f"{grips / took_s * 60:.0f} grips a minute for {took_s:.0f} s, {messages / took_s:.0f} messages a second")
            print(f"processor time of the gateway with its simulated grippers: {used_s / took_s * 100:.1f} % of a core")
            print(f"events at the subscriber after {quantiles[49]:.1f} ms (median), {quantiles[98]:.1f} ms (p99), "
                  f"{max(delays_ms):.1f} ms (maximum of {len(delays_ms)})")
            gateway.terminate()
        finally:
            gateway.kill()
            broker.kill()


main()
