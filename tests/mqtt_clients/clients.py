"""Clients that nobody here wrote: paho, aiomqtt and MQTT.js. Checks state, records, commands and FAST STOP with Mosquitto,
as docker-compose.yml configures it."""

from __future__ import annotations

import asyncio
import json
import subprocess
from pathlib import Path

import aiomqtt
import paho.mqtt.client as mqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from rig import SIMULATED, Broker, Gateway, broker_section, compare, compose_settings, guide_subscriber, temporary_directory, until

PREFIX = "wsg/cell"


def with_paho(broker: Broker, gateway: Gateway) -> None:
    """Retained messages, and a FAST STOP with an answer."""
    got: dict[str, mqtt.MQTTMessage] = {}
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
    client.on_message = lambda _client, _data, message: got.__setitem__(message.topic, message)
    client.on_connect = lambda client, *_: client.subscribe([(f"{PREFIX}/#", 1), ("answers/paho", 1)])
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    for topic in ("availability", "description", "alarms", "g0/state"):
        message = until(topic, lambda: got.get(f"{PREFIX}/{topic}"))
        assert message.retain, topic
    assert got[f"{PREFIX}/availability"].payload == b"online"
    state = json.loads(got[f"{PREFIX}/g0/state"].payload)
    assert (state["gripper"], state["link"]) == ("g0", "connected"), state
    assert dict(got[f"{PREFIX}/g0/state"].properties.UserProperty)["schema"] == "GripperState"

    properties = Properties(PacketTypes.PUBLISH)
    properties.ResponseTopic = "answers/paho"
    properties.CorrelationData = b"stop-1"
    client.publish(f"{PREFIX}/fast-stop", '{"reason": "light curtain"}', qos=1, properties=properties)
    answer = until("the answer", lambda: got.get("answers/paho"))
    assert answer.properties.CorrelationData == b"stop-1"
    stop = json.loads(answer.payload)
    assert {*stop["confirmed"], *stop["unconfirmed"]} == set(gateway.names), stop
    for name in gateway.names:
        state = f"/api/v1/grippers/{name}/state"
        until("the confirmation", lambda: gateway.get(state)["fast_stop_confirmed"])
        gateway.post(f"/grippers/{name}/acknowledge", {"fast_stop_id": stop["fast_stop_id"]})
    client.loop_stop()
    print("paho: retained messages and FAST STOP")


async def with_aiomqtt(broker: Broker) -> None:
    """Requests and their answers."""
    async with aiomqtt.Client("127.0.0.1", broker.port, protocol=aiomqtt.ProtocolVersion.V5) as client:
        await client.subscribe("answers/aiomqtt", qos=1)

        async def ask(topic: str, body: object, **user_properties: str) -> tuple[dict[str, str], dict]:
            properties = Properties(PacketTypes.PUBLISH)
            properties.ResponseTopic = "answers/aiomqtt"
            properties.CorrelationData = topic.encode()
            properties.UserProperty = list(user_properties.items())
            await client.publish(f"{PREFIX}/{topic}", json.dumps(body), qos=1, properties=properties)
            answer = await asyncio.wait_for(anext(aiter(client.messages)), 30)
            assert answer.properties.CorrelationData == topic.encode()
            return dict(answer.properties.UserProperty), json.loads(answer.payload)

        status, homed = await ask("g0/command/home", {}, wait_ms="20000")
        assert (status["status"], homed["outcome"]) == ("200", "SUCCESS"), homed
        request = {"wait_ms": "20000", "request_id": "job-1", "client": "mes"}
        _, grip = await ask("g0/command/grip", {"width_mm": 20, "speed_mm_s": 200}, **request)
        assert grip.get("outcome") == "PART_HELD", grip
        _, repeated = await ask("g0/command/grip", {"width_mm": 20, "speed_mm_s": 200}, **request)
        assert repeated["id"] == grip["id"], repeated
        status, refused = await ask("g0/command/move", {"width_mm": 500, "speed_mm_s": 200})
        assert (status["status"], refused["code"]) == ("422", "out_of_range"), refused
    print("aiomqtt: requests, answers and refusals")


def main() -> None:
    with temporary_directory() as directory:
        broker = Broker(directory, settings=compose_settings())
        gateway = Gateway(directory, [SIMULATED] * 2, broker_section(broker.url, "commands = true\nfast_stop = true"))
        try:
            for gripper in gateway.names:
                state = f"/api/v1/grippers/{gripper}/state"
                until("the link", lambda: gateway.get(state)["link"] == "connected")
            until("all connections", lambda: gateway.metric("wsg_mqtt_connected") == 3)
            with guide_subscriber(directory, broker, PREFIX) as database:
                until("the subscriber", database.exists)
                with_paho(broker, gateway)
                asyncio.run(with_aiomqtt(broker))
                program = Path(__file__).with_name("requests.mjs")
                subprocess.run(["node", str(program), str(broker.port)], check=True, timeout=60)
                print("subscriber of the guide:", compare(gateway, database))
            gateway.terminate()
        finally:
            gateway.kill()
            broker.kill()


main()
