"""Errors that the package raises."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from ._model import Result
    from ._types import Code, ServoEnd


class GatewayError(Exception):
    """Any error of this package, apart from wrong arguments and `TimeoutError`."""


class Refused(GatewayError):
    """The gateway or the gripper refused a request. A refused motion has moved nothing.

    The exceptions are the codes `internal` and `gateway_timeout`, where it is not known whether something moved.
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        """Keeps the problem that the gateway sent."""
        self.problem = dict(problem)
        """The whole problem, as JSON."""
        self.code = cast("Code", problem.get("code", "internal"))
        """The cause. Codes never change; later versions of the gateway can have more."""
        self.detail = str(problem.get("detail", ""))
        """The problem and its remedy, for people."""
        self.status = int(problem.get("status", 500))
        """The HTTP status."""
        self.field: str | None = problem.get("field")
        """Name of the wrong field, if one is wrong."""
        self.value: Any = problem.get("value")
        """Value of that field, if it is short."""
        self.min: float | None = problem.get("min")
        """Lowest allowed value, in the unit of the field."""
        self.max: float | None = problem.get("max")
        """Highest allowed value, in the unit of the field."""
        self.holder: str | None = problem.get("holder")
        """Holder of the lease, if the lease prevents the request."""
        self.command_id: str | None = problem.get("command_id")
        """Id of the running command that prevents the request."""
        self.fast_stop_id: str | None = problem.get("fast_stop_id")
        """Id of the latched FAST STOP."""
        self.device_status: str | None = problem.get("device_status")
        """Status with which the gripper itself refused the request, such as `E_ACCESS_DENIED`."""
        super().__init__(f"{self.code}: {self.detail}")


class Unreachable(GatewayError):
    """The package has no connection to the gateway, and connects again by itself."""


class ConnectionLost(Unreachable):
    """The connection ended while a request waited for its response. The request may have been carried out."""


class ControlLost(GatewayError):
    """The lease is lost: it was taken away or expired, or the connection or the gateway was restarted.

    The motion of the call that raises this error was not started. The result of a motion that had started before is
    returned to the call that waits for it. To continue, read the state of the gripper, and enter `control` again.
    """

    def __init__(self, gripper: str, reason: str, holder: str | None = None) -> None:
        """Says why, and who holds the lease now."""
        self.gripper = gripper
        """Name of the gripper."""
        self.reason = reason
        """Why the lease is lost, for people."""
        self.holder = holder
        """Name of the new holder, if there is one."""
        super().__init__(f"control of {gripper} is lost: {reason}. Read the state, then take control again")


class ServoEnded(GatewayError):
    """The servo session has ended, and the gateway has stopped the fingers. The target of this call was not sent.

    To continue, make sure that the fingers may move, and begin a new session.
    """

    def __init__(self, gripper: str, reason: ServoEnd, detail: str) -> None:
        """Says why."""
        self.gripper = gripper
        """Name of the gripper."""
        self.reason = reason
        """What ended the session, such as `silence` or `fast_stop`."""
        self.detail = detail
        """The reason, for people."""
        super().__init__(f"the servo session of {gripper} has ended ({reason}): {detail}. Read the state, then begin a new one")


class ValueUnknown(GatewayError):
    """A value is not known at present: the gripper does not send it, or the newest one is too old."""


class StopUnconfirmed(GatewayError):
    """No gateway answered the FAST STOP: it is not known whether it arrived. Use the hardware emergency stop."""


class StreamEnded(GatewayError):
    """The iterator or its gateway was closed."""


class UnexpectedOutcome(GatewayError):
    """A motion ended with another outcome than `expect` allows."""

    def __init__(self, motion: Result) -> None:
        """Keeps the motion."""
        self.motion = motion
        """The motion with its outcome."""
        detail = f": {motion.detail}" if motion.detail else ""
        if motion.fast_stop_id:
            detail = f" by FAST STOP {motion.fast_stop_id}{detail}: remove its cause, then acknowledge it by this id"
        elif motion.outcome == "UNKNOWN" and not motion.detail:
            detail = ": whether it was carried out is not known"
        super().__init__(f"{motion.kind} of {motion.gripper} ended as {motion.outcome}{detail}")
