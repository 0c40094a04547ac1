"""Steering by the targets of a topic. A session begins with the first target after a pause, and goals end it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from wsg_gateway import Control, GatewayError, ServoEnded
from wsg_gateway import Servo as Session

from .motions import LOOK_S, Motions

# Pause after which targets begin a new session, if something other than a pause has ended the last one.
PAUSE_S = 0.5


class Steering:
    """Feeds targets to servo sessions of a gripper."""

    def __init__(self, motions: Motions, terms: dict[str, Any], log: Callable[[str], None]) -> None:
        """Begins sessions by these terms. `log` takes what a person has to know."""
        self._motions, self._terms, self._log = motions, terms, log
        self._timeout_s = terms["timeout_ms"] / 1000
        self._heard_at = float("-inf")
        self._newest_mm = 0.0
        self._session: Session | None = None
        self._is_running = False
        self._reason = "silence"
        """What ended the last session."""
        self._is_fresh = False
        """Whether a pause came before the newest targets, which no session has taken yet."""

    def target(self, width_mm: float) -> None:
        """Takes a target. Never waits. Raises `ValueError` for a width that no gripper has."""
        now = time.monotonic()
        pause_s, self._heard_at = now - self._heard_at, now
        self._newest_mm = width_mm
        if (session := self._session) is not None:
            try:
                return session.target(width_mm)
            except ServoEnded as ended:
                self._reason = ended.reason
        # A Stop of somebody holds until the publisher pauses: its next target would otherwise follow a moment later.
        self._is_fresh |= pause_s >= (self._timeout_s if self._reason == "silence" else max(self._timeout_s, PAUSE_S))
        if not self._is_fresh or self._is_running:
            return
        self._is_fresh = False
        token = object()
        if not self._motions.announce_if_idle(token):
            self._reason = "goal"
            return self._log("targets are ignored while a goal or a service moves the gripper")
        self._is_running = True
        threading.Thread(target=self._run, args=[token], name="steering", daemon=True).start()

    def _run(self, token: object) -> None:
        try:
            with self._motions.turn(token) as control:
                # Targets that come before the end of this block ask the session itself.
                reason = self._steer(control, token)
            self._reason = reason
            self._log(f"steering has ended: {reason}")
        except (GatewayError, TimeoutError, ValueError) as error:
            self._reason = "refused"
            self._log(f"steering did not begin: {error}")
        finally:
            self._session, self._is_running = None, False

    def _steer(self, control: Control, token: object) -> str:
        """Steers until the session has ended, and returns why."""
        if time.monotonic() > self._heard_at + self._timeout_s:
            return "silence"
        with control.servo(**self._terms) as session:
            self._session = session
            self._log("steering begins")
            session.target(self._newest_mm)
            while session.ended is None and self._motions.is_newest(token):
                time.sleep(LOOK_S)
            return session.ended or "a goal or a service moves the gripper"
