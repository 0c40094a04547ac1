"""MCAP files of the package, read by `mcap` and by `rosbags`."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import wsg_gateway
from gateways import Gateway, until
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from wsg_gateway import mcap


def by_mcap(path: Path) -> list[tuple[str, int, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(channel.topic, message.log_time, decoded) for _, channel, message, decoded in reader.iter_decoded_messages()]


def by_rosbags(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        return [(connection.topic, at, reader.deserialize(data, connection.msgtype)) for connection, at, data in reader.messages()]


@pytest.fixture
def recorded(gateway: Gateway, tmp_path: Path) -> tuple[Path, wsg_gateway.Motion]:
    """A file with a grip, a release and what happened meanwhile."""
    path = tmp_path / "run.mcap"
    with wsg_gateway.connect(gateway.url) as client, client["left"].control("mcap") as gripper:
        gripper.release(60, 300)
        with mcap.Recorder(client, path):
            grip = gripper.grip(20, 200, force_n=30, part_id="A-1")
            gripper.release(60, 300)
    return path, grip


@pytest.mark.parametrize("read", [by_mcap, by_rosbags])
def test_recording_is_read(recorded: tuple[Path, wsg_gateway.Motion], read: Any) -> None:
    path, grip = recorded
    messages = read(path)
    topics = Counter(topic for topic, _, _ in messages)
    assert set(topics) == {"/wsg/left/state", "/wsg/right/state", "/wsg/left/grips", "/wsg/left/curve", "/wsg/events"}
    records = [json.loads(message.json) for topic, _, message in messages if topic == "/wsg/left/grips"]
    assert [record["part_id"] for record in records if record["kind"] == "grip"] == ["A-1"]
    curve = [(at, message) for topic, at, message in messages if topic == "/wsg/left/curve" and message.command_id == grip.id]
    assert max(message.force_n for _, message in curve) > 25
    assert [at for at, _ in curve] == sorted(at for at, _ in curve)
    # A sample has the time of its measurement, which lies in the motion.
    begun = grip.started_at.timestamp() * 1e9
    assert 0 <= curve[0][0] - begun < 0.2e9 and curve[-1][0] - begun < (grip.duration_ms or 0) * 1e6 + 1.5e9
    states = [message for topic, _, message in messages if topic == "/wsg/left/state"]
    assert {"HOLDING", "RELEASING"} & {state.state for state in states} and all(state.link == "connected" for state in states)
    assert all(json.loads(state.json)["gripper"] == "left" for state in states)
    kinds = {message.kind for topic, _, message in messages if topic == "/wsg/events"}
    assert "command" in kinds


def test_values_that_are_not_known_are_nan(tmp_path: Path) -> None:
    path = tmp_path / "unknown.mcap"
    gateway = Gateway()
    gateway.start()
    try:
        with wsg_gateway.connect(gateway.url) as client, mcap.Recorder(client, path):
            until(lambda: client["left"].speed_mm_s == 0)
    finally:
        gateway.kill()
    states = [message for topic, _, message in by_mcap(path) if topic == "/wsg/left/state"]
    # The gripper is not referenced.
    assert states and all(math.isnan(state.width_mm) and state.speed_mm_s == 0 for state in states)


def test_journal_is_exported(recorded: tuple[Path, wsg_gateway.Motion], gateway: Gateway, tmp_path: Path) -> None:
    path = tmp_path / "journal.mcap"
    with wsg_gateway.connect(gateway.url) as client:
        mcap.export(client, path, since=recorded[1].started_at.isoformat())
    messages = by_mcap(path)
    records = [json.loads(message.json)["id"] for topic, _, message in messages if topic == "/wsg/left/grips"]
    assert recorded[1].id in records
    assert {"/wsg/left/curve", "/wsg/events"} <= {topic for topic, _, _ in messages}
