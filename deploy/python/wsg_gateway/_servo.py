"""Servo sessions: the newest target goes to the gateway, and nothing waits for an answer."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from typing import Any

from ._control import ControlCore
from ._engine import Engine
from ._errors import GatewayError, Refused, ServoEnded, Unreachable
from ._types import ServoEnd, ServoReport

logger = logging.getLogger("wsg_gateway")

# The gateway delays the requests of a connection that sends more than 1,000 a second.
PAUSE_S = 0.002
# Longest wait for fingers that stop, the time for which they have to stand still, and that between two looks at them.
SETTLES_S, STANDS_S, LOOK_S = 1.0, 0.15, 0.02
LARGEST_MM = 1000.0
ENDS = {
    "ended": "its block has ended",
    "stop": "somebody sent a Stop",
    "fast_stop": "somebody triggered a FAST STOP",
    "device": "the gripper refused a target or did not answer it; the gateway's log says more",
    "link": "the gateway has no connection to the gripper",
}


class Steering:
    """The targets and the feedback of a servo session. They send no request that is answered, and never wait."""

    def __init__(self, engine: Engine, lease: ControlCore, terms: dict[str, Any]) -> None:
        """Use `servo` of a gripper under control."""
        self._engine, self._lease, self._terms = engine, lease, terms
        self._report: ServoReport | None = None
        # A target that was not sent yet is replaced by a newer one.
        self._newest: deque[tuple[str, dict[str, Any]]] = deque(maxlen=1)
        self._ready, self._is_ready = asyncio.Event(), False
        self._sender: asyncio.Task[None] | None = None
        self._search: asyncio.Task[None] | None = None

    @property
    def report(self) -> ServoReport:
        """The newest values of the session that the gateway has pushed; after the block, the final ones."""
        if self._report is None:
            raise RuntimeError("this servo session has not begun: write `with gripper.servo() as servo`")
        return self._report

    @property
    def ended(self) -> ServoEnd | None:
        """The reason that the session has ended, such as `silence`, as far as this program knows; `None` while it is open."""
        return self.report.ended or (None if self._lease.is_held else "lease")

    @property
    def rate_hz(self) -> float | None:
        """The number of targets per second that this gripper takes while further ones wait; `None` if never measured."""
        return self.report.rate_hz

    @property
    def applied_mm(self) -> float | None:
        """The newest target in mm that the gripper has answered; `None` before the first."""
        return self.report.applied_mm

    @property
    def age_ms(self) -> float | None:
        """The age of that target in ms when the gripper answered it; `None` before the first."""
        return self.report.applied_age_ms

    def target(self, width_mm: float, speed_mm_s: float | None = None, *, at: datetime | None = None) -> None:
        """Sets the newest target: a width in mm, and a speed in mm/s, which is `max_speed_mm_s` by default.

        It replaces an older target that the gripper has not got yet. Send it again while it does not change: silence for
        `timeout_ms` ends the session. With `at`, the time that it belongs to by the gateway's clock, the gateway ignores
        it if it is older than `timeout_ms` or than the newest one.

        Raises `ServoEnded` if the session has ended, and `ValueError` for a value that is never allowed. A target beyond
        the limits of the gripper is refused by the gateway, which `report.refused` counts.
        """
        fastest = self.report.max_speed_mm_s
        if speed_mm_s is not None and not 0 <= speed_mm_s <= fastest:
            raise ValueError(f"speed_mm_s is {speed_mm_s}: it must be from 0 to max_speed_mm_s, {fastest:g}")
        speed = None if speed_mm_s is None else float(speed_mm_s)
        self._put("servo.target", width_mm=width(width_mm), speed_mm_s=speed, at=timestamp(at))

    def follow(self, widths_mm: Iterable[float], dt_ms: int, *, at: datetime | None = None) -> None:
        """Follows 1 to 256 widths in mm with `dt_ms` (1 to 1000 ms) between two of them, for up to 10 s.

        The gateway interpolates, and a newer target or series replaces the rest. The last width stays the target, and
        silence counts from its time. `at` is the time of the first width by the gateway's clock, up to 1 s ahead; now by
        default.

        Raises `ServoEnded` and `ValueError` as `target` does, also for widths that need more than `max_speed_mm_s`.
        """
        widths, fastest = [width(one) for one in widths_mm], self.report.max_speed_mm_s
        if not (1 <= len(widths) <= 256 and dt_ms in range(1, 1001) and (len(widths) - 1) * dt_ms <= 10_000):
            raise ValueError(f"{len(widths)} widths and {dt_ms} ms: 1 to 256 widths, with 1 to 1000 ms between, take up to 10 s")
        speed = max((abs(after - before) * 1000 / dt_ms for before, after in pairwise(widths)), default=0)
        if speed > fastest:
            raise ValueError(f"the widths need {speed:g} mm/s: max_speed_mm_s is {fastest:g}")
        self._put("servo.follow", widths_mm=widths, dt_ms=int(dt_ms), at=timestamp(at))

    def _put(self, method: str, **params: Any) -> None:
        """Leaves a notification to the thread of the engine."""
        if (reason := self.ended) is not None:
            raise ServoEnded(self._lease.gripper, reason, self._why(reason))
        self._newest.append((method, params))
        if not self._is_ready:
            self._is_ready = True
            self._engine.wake(self._ready.set)

    def _why(self, reason: str) -> str:
        if reason == "silence":
            refused = f", and refused {self.report.refused}" if self.report.refused else ""
            return f"the gateway accepted no target for {self.report.timeout_ms} ms{refused}"
        return self._lease.loss().reason if reason == "lease" else ENDS.get(reason, reason)

    # Everything below runs in the thread of the engine.

    async def _begin(self) -> None:
        self._report = None
        self._newest.clear()
        await self._lease.core.watch_servos()
        self._report = ServoReport.build(await self._lease.call("servo.start", **self._terms))
        self._lease.core.servos.add(self._stated)
        self._sender = asyncio.create_task(self._send())

    async def _end(self) -> None:
        """Ends the session, unless it has ended already, and waits for the fingers. Without an answer, silence ends it."""
        self._lease.core.servos.discard(self._stated)
        for task in (self._sender, self._search):
            if task is not None:
                task.cancel()
        with contextlib.suppress(GatewayError):
            if self.ended is None:
                try:
                    self._report = ServoReport.build(await self._lease.call("servo.stop"))
                except Refused:
                    await self._find_end()
            await self._settle()

    async def _settle(self) -> None:
        """Waits until the last target has ended and the fingers stand still: the next motion would be refused before.

        A script can carry out a target that it got before the Stop. Then the gateway sends another Stop.
        """
        deadline = still_at = time.monotonic() + SETTLES_S
        while self._lease.is_held and time.monotonic() < deadline:
            calls = [self._lease.core.main.call(method, gripper=self._lease.gripper) for method in ("command.latest", "state")]
            command, state = await asyncio.gather(*calls)
            is_still = command["phase"] == "done" and not state["moving"]
            still_at = min(still_at, time.monotonic()) if is_still else deadline
            if time.monotonic() >= still_at + STANDS_S:
                return
            await asyncio.sleep(LOOK_S)

    async def _send(self) -> None:
        """Sends the newest target whenever there is one, and the connection has taken the one before."""
        while True:
            await self._ready.wait()
            self._ready.clear()
            self._is_ready = False
            while self._newest:
                method, params = self._newest.popleft()
                with contextlib.suppress(Unreachable):  # The lease is lost, too, which the next target reports.
                    await self._lease.notify(method, **params)
                await asyncio.sleep(PAUSE_S)

    def _stated(self, gripper: str, session: dict[str, Any] | None) -> None:
        """Takes the open session of a gripper, which the gateway has pushed."""
        if gripper != self._lease.gripper or self.report.ended is not None:
            return
        report = None if session is None else ServoReport.build(session)
        if report is None or report.started_at != self.report.started_at:
            if self._search is None or self._search.done():
                self._search = asyncio.create_task(self._find_end())
            return
        if report.refused > 0 and self.report.refused == 0:
            logger.warning("the gateway refused a target of %s: is it beyond the limits of the gripper?", gripper)
        self._report = report

    async def _find_end(self) -> None:
        """Asks why the session is not open any more."""
        with contextlib.suppress(GatewayError):  # Asked again at the next state, once a second at least.
            answer = await self._lease.core.main.call("servo", gripper=self._lease.gripper)
            report = ServoReport.build(answer)
            # Another client can begin a session only after this one has lost the lease.
            is_own = report.started_at == self.report.started_at
            self._report = report if is_own else replace(self.report, open=False, ended="lease")


def width(width_mm: float) -> float:
    """Checks a width in mm. A number of an array becomes a `float`, which JSON can hold, and NaN is refused."""
    if not 0 <= width_mm <= LARGEST_MM:
        raise ValueError(f"a width of {width_mm} mm: it must be a number from 0 to the stroke of the gripper")
    return float(width_mm)


def timestamp(at: datetime | None) -> str | None:
    if at is not None and at.tzinfo is None:
        raise ValueError("`at` has no time zone: the gateway's clock is in UTC")
    return None if at is None else at.isoformat()
