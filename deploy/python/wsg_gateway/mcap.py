"""MCAP files with the states, motions, curves and events of a gateway: `pip install wsg-gateway[mcap]`.

The files have the profile and the message definitions of ROS 2, so that ROS tools, Foxglove, `mcap` and `rosbags` read
them without this package. A number that is not known is NaN, and a text that is not known is empty.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterable
from datetime import datetime, timedelta, timezone
from types import TracebackType
from typing import Any

from ._extra import needed_by
from ._model import Model
from ._sync import Gateway, Stream
from ._types import Curve, State

with needed_by("mcap"):
    from mcap_ros2.writer import Writer

STATE = """# State of a gripper. NaN and empty texts are not known.
float64 width_mm
float64 speed_mm_s
float64 force_n
float64 temperature_c
string state
string link
string json # all values
"""
SAMPLE = """# Sample of the curve of a motion.
string command_id
float64 width_mm
float64 speed_mm_s
float64 force_n
"""
RECORD = """# Grip record or event.
string kind
string json # all values
"""
DEFINITIONS = {"State": STATE, "Sample": SAMPLE, "Record": RECORD}
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
# A grip's record is written a second after its end.
RECORD_S = 1.2


def nanoseconds(at: datetime) -> int:
    """Time since 1970 in ns."""
    return (at - EPOCH) // timedelta(microseconds=1) * 1000


def as_json(item: Model) -> str:
    return json.dumps(item.as_dict(), default=str)


def number(value: float | None) -> float:
    return float("nan") if value is None else value


class File:
    """An MCAP file that is written. Times are those of the measurement, by the gateway's clock."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Creates the file."""
        self._writer = Writer(os.fspath(path))
        self._lock, self._is_closed = threading.Lock(), False
        self._schemas = {name: self._writer.register_msgdef(f"wsg_gateway/msg/{name}", DEFINITIONS[name]) for name in DEFINITIONS}

    def state(self, state: State) -> None:
        """Writes a state. One without a measured value has the time of now."""
        names = ("width_mm", "speed_mm_s", "force_n", "temperature_c")
        message: dict[str, Any] = {name: number(getattr(state, name)) for name in names}
        message |= {"state": state.state or "", "link": state.link, "json": as_json(state)}
        at = state.measured_at or datetime.now(timezone.utc)
        self._write(f"/wsg/{state.gripper}/state", "State", at, message)

    def curve(self, gripper: str, curve: Curve, started_at: datetime) -> None:
        """Writes a curve. Older curves have no time of measurement: their time is that of their motion."""
        first = curve.measured_at or started_at
        samples = zip(curve.t_ms, curve.width_mm, curve.speed_mm_s, curve.force_n, strict=True)
        for t_ms, width_mm, speed_mm_s, force_n in samples:
            message = {"command_id": curve.id, "width_mm": width_mm, "speed_mm_s": speed_mm_s, "force_n": force_n}
            self._write(f"/wsg/{gripper}/curve", "Sample", first + timedelta(milliseconds=t_ms), message)

    def records(self, gateway: Gateway, curves: bool = True, **filters: Any) -> None:
        """Writes grip records of the journal, with their curves. The filters are those of `gateway.records.grips`."""
        for grip in gateway.records.grips(None, **filters):
            message = {"kind": grip.kind, "json": as_json(grip)}
            self._write(f"/wsg/{grip.gripper}/grips", "Record", grip.started_at, message)
            if curves and grip.samples:
                self.curve(grip.gripper, gateway.records.curve(grip.id), grip.started_at)

    def events(self, gateway: Gateway, **filters: Any) -> None:
        """Writes events of the journal. The filters are those of `gateway.records.events`."""
        for event in gateway.records.events(None, **filters):
            data: dict[str, Any] = getattr(event, "data", None) or event.as_dict()
            at = data["at"] if isinstance(data["at"], datetime) else datetime.fromisoformat(data["at"].replace("Z", "+00:00"))
            self._write("/wsg/events", "Record", at, {"kind": data["kind"], "json": json.dumps(data, default=str)})

    def close(self) -> None:
        """Writes the index, without which the file is incomplete. What comes later is left out."""
        with self._lock:
            self._is_closed = True
            self._writer.finish()

    def _write(self, topic: str, kind: str, at: datetime, message: dict[str, Any]) -> None:
        with self._lock:  # States come in another thread.
            if not self._is_closed:
                self._writer.write_message(topic, self._schemas[kind], message, nanoseconds(at))


class Recorder:
    """Records a block of a program: `with Recorder(gateway, "run.mcap"): …`.

    States are written as they are pushed. The records, curves and events since the beginning of the block are read from
    the journal at its end, so none is missing after a lost connection.
    """

    def __init__(self, gateway: Gateway, path: str | os.PathLike[str]) -> None:
        """Creates the file."""
        self._gateway, self._file = gateway, File(path)
        self._states: Stream[State] | None = None
        self._first = {"grips": 0, "events": 0}

    def __enter__(self) -> Recorder:
        """Starts to record."""
        records = self._gateway.records
        self._first = {"grips": newest(records.grips(1, kind="all")), "events": newest(records.events(1))}
        self._states = self._gateway.telemetry(1024).follow(self._file.state)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Completes the file, also after an exception."""
        try:
            time.sleep(RECORD_S)
            if self._states is not None:
                self._states.close()
            self._file.records(self._gateway, kind="all", after=self._first["grips"])
            self._file.events(self._gateway, after=self._first["events"])
        finally:
            self._file.close()


def newest(records: Iterable[Any]) -> int:
    """The number of the newest record, or 0."""
    return max((record.seq for record in records), default=0)


def export(gateway: Gateway, path: str | os.PathLike[str], *, since: str | None = None, until: str | None = None) -> None:
    """Writes all records, curves and events of the journal between two times, such as `2026-11-21T09:00:00Z`."""
    file = File(path)
    try:
        file.records(gateway, kind="all", since=since, until=until)
        file.events(gateway, since=since, until=until)
    finally:
        file.close()
