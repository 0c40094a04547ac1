"""Client of a WSG gateway, which shares Weiss and SCHUNK WSG grippers. `wsg_gateway.aio` has the same names for asyncio."""

from ._core import ClockOffset, FastStop
from ._errors import (
    ConnectionLost,
    ControlLost,
    GatewayError,
    Refused,
    ServoEnded,
    StopUnconfirmed,
    StreamEnded,
    UnexpectedOutcome,
    Unreachable,
    ValueUnknown,
)
from ._model import OtherEvent, columns
from ._sync import Control, Gateway, Gripper, Recipes, Records, Servo, Stream, connect
from ._types import Code, Curve, Event, EventKind, GripRecord, Info, Motion, Outcome, Recipe, ServoReport, State

__version__ = "0.2.0"

__all__ = [
    "ClockOffset",
    "Code",
    "ConnectionLost",
    "Control",
    "ControlLost",
    "Curve",
    "Event",
    "EventKind",
    "FastStop",
    "Gateway",
    "GatewayError",
    "GripRecord",
    "Gripper",
    "Info",
    "Motion",
    "OtherEvent",
    "Outcome",
    "Recipe",
    "Recipes",
    "Records",
    "Refused",
    "Servo",
    "ServoEnded",
    "ServoReport",
    "State",
    "StopUnconfirmed",
    "Stream",
    "StreamEnded",
    "UnexpectedOutcome",
    "Unreachable",
    "ValueUnknown",
    "columns",
    "connect",
]
