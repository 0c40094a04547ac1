"""The state of a gripper as a message of `diagnostic_msgs`."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from wsg_gateway import State

# Shown with their values. An unknown value is a question mark.
SHOWN = (
    "link",
    "state",
    "referenced",
    "moving",
    "width_mm",
    "force_n",
    "temperature_c",
    "fast_stop_id",
    "fast_stop_cause",
    "fast_stop_by",
    "fast_stop_reason",
    "lease_holder",
    "reserved_for",
    "age_ms",
    "fault_code",
)


def judged(state: State | None, is_connected: bool) -> tuple[bytes, str]:
    """The level of a state, and what to do."""
    if not is_connected:
        return DiagnosticStatus.ERROR, "no connection to the gateway: is it running, and is the parameter url right?"
    if state is None:
        return DiagnosticStatus.STALE, "the gateway has sent no state lately"
    if state.link != "connected":
        return DiagnosticStatus.ERROR, f"no connection to the gripper: {state.link_cause or state.link}"
    if state.fast_stop is None or state.stale:
        return DiagnosticStatus.ERROR, f"values are not known: {', '.join(state.stale) or 'FAST STOP'}"
    if state.fast_stop:
        return DiagnosticStatus.ERROR, "FAST STOP: remove its cause, then call the service acknowledge"
    if state.fault:
        return DiagnosticStatus.ERROR, f"fault {state.fault_code}"
    if not state.referenced:
        return DiagnosticStatus.WARN, "not referenced: call the service home"
    return DiagnosticStatus.OK, state.state or ""


def status(name: str, hardware: str, state: State | None, is_connected: bool, newest: str) -> DiagnosticStatus:
    """The message."""
    level, message = judged(state, is_connected)
    values = [KeyValue(key="newest_outcome", value=newest or "?")]
    if state is not None:
        values += [KeyValue(key=key, value=shown(getattr(state, key))) for key in SHOWN]
    return DiagnosticStatus(level=level, name=name, message=message, hardware_id=hardware, values=values)


def shown(value: object) -> str:
    return "?" if value is None else str(value)
