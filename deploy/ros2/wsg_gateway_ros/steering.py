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
        self._heard_at = self._taken_at = float("-inf")
        """Times of the newest message, and of the newest one with a target within the limits."""
        self._newest_mm = 0.0
        self._session: Session | None = None
        self._is_running = False
        self._reason = "silence"
        """What ended the last session."""
        self._is_fresh = False
        """Whether a pause came before the newest targets, which no session has taken yet."""

    def target(self, width_mm: float) -> None:
        """Takes a target. Never waits. Raises `ValueError` for a width that no gripper has."""
        pause_s = self._pause_s()
        self._newest_mm, self._taken_at = width_mm, self._heard_at
        if (session := self._session) is not None:
            try:
                return session.target(width_mm)
            except ServoEnded as ended:
                self._reason = ended.reason
        self._note_pause(pause_s)
        if not self._is_fresh or self._is_running:
            return
        self._is_fresh = False
        token = object()
        if not self._motions.announce_if_idle(token):
            self._reason = "goal"
            return self._log("targets are ignored while a goal or a service moves the gripper")
        self._is_running = True
        threading.Thread(target=self._run, args=[token], name="steering", daemon=True).start()

    def ignored(self) -> None:
        """Notes a target beyond the limits. It moves nothing, but its publisher has not paused."""
        pause_s = self._pause_s()
        if (session := self._session) is not None:
            if session.ended is None:
                return
            self._reason = session.ended
        self._note_pause(pause_s)

    def _pause_s(self) -> float:
        """Notes that a message has come, and returns the time since the one before."""
        now = time.monotonic()
        pause_s, self._heard_at = now - self._heard_at, now
        return pause_s

    def _note_pause(self, pause_s: float) -> None:
        """A Stop of somebody holds until the publisher pauses: its next target would otherwise follow a moment later."""
        # The gateway counts silence from the newest target that it accepted, which can be a little older.
        silence_s = 0.9 * self._timeout_s
        self._is_fresh |= pause_s >= (silence_s if self._reason == "silence" else max(self._timeout_s, PAUSE_S))

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
        if time.monotonic() > self._taken_at + self._timeout_s:
            return "silence"
        with control.servo(**self._terms) as session:
            # A pause before the session counts no more.
            self._session, self._is_fresh = session, False
            self._log("steering begins")
            session.target(self._newest_mm)
            while session.ended is None and self._motions.is_newest(token):
                time.sleep(LOOK_S)
            return session.ended or "a goal or a service moves the gripper"
