"""The lease of a gripper, and the motions under it."""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from dataclasses import dataclass
from typing import Any

from ._core import READ_S, Core
from ._errors import ConnectionLost, ControlLost, GatewayError, Refused, Unreachable
from ._stream import Queue
from ._types import Lease, Motion, State

# Pauses between two attempts to take a lease, and between two questions for a command of another connection.
RETRY_S, POLL_S = 0.2, 0.1
# The gateway keeps request ids for 10 minutes. Later, an id that it does not know proves nothing.
IDS_KEPT_S = 9 * 60
# Refusals of a read that say nothing about the command.
PASSING = {"overloaded", "request_timeout", "internal", "journal_down", "device_timeout", "gateway_timeout"}


@dataclass(frozen=True)
class Terms:
    """How a lease is taken."""

    holder: str | None
    on_loss_moving: str | None
    on_loss_holding: str | None
    if_held: str
    timeout_s: float
    ttl_ms: int | None
    force: bool
    patience_s: float


@dataclass(frozen=True)
class Sending:
    """The facts that were known when a motion was sent."""

    kind: str
    request_id: str
    sent_at: float
    journal_id: str | None
    is_recorded: bool


class ControlCore:
    """A lease, which lasts as long as the connection that it was taken on."""

    def __init__(self, core: Core, gripper: str, terms: Terms) -> None:
        """Prepares the lease; `take` takes it."""
        self.core, self.gripper, self.terms = core, gripper, terms
        self.losses = self._new_losses()
        self._token: str | None = None
        self._epoch = 0
        self._lost: tuple[str, str | None] | None = ("it was not taken yet", None)
        self._renewal: asyncio.Task[None] | None = None

    def _new_losses(self) -> Queue[ControlLost]:
        return Queue(f"losses of control of {self.gripper}", self.gripper, 1)

    @property
    def is_held(self) -> bool:
        """Whether the lease is held, as far as this client knows."""
        return self._lost is None

    async def take(self) -> None:
        """Takes the lease as the terms say."""
        deadline = time.monotonic() + self.terms.timeout_s
        while not await self._taken(deadline):
            await asyncio.sleep(RETRY_S)

    async def _taken(self, deadline: float) -> bool:
        """Tries once to take the lease."""
        link, terms = self.core.main, self.terms
        await link.up(max(deadline - time.monotonic(), 0))
        generation = link.generation
        asked = link.call(
            "lease.take",
            gripper=self.gripper,
            holder=terms.holder,
            on_loss_moving=terms.on_loss_moving,
            on_loss_holding=terms.on_loss_holding,
            ttl_ms=terms.ttl_ms,
            request=terms.if_held == "request" or None,
            force=terms.force or None,
        )
        task = asyncio.ensure_future(asked)
        try:
            answer = await asyncio.shield(task)
        except asyncio.CancelledError:
            # Nobody will use this lease. The holder of an answer that still comes has to be released.
            task.add_done_callback(self._give_back)
            raise
        except Unreachable:
            if time.monotonic() >= deadline:
                raise
            return False
        except Refused as refused:
            if refused.code != "lease_held" or terms.if_held == "fail" or time.monotonic() >= deadline:
                raise
            return False
        if "token" not in answer:
            if time.monotonic() >= deadline:
                raise TimeoutError(f"{answer['holder']} did not hand {self.gripper} over within {terms.timeout_s:g} s")
            return False
        self._hold(answer, generation)
        return True

    def _hold(self, answer: dict[str, Any], generation: int) -> None:
        self._token, self._epoch, self._lost = answer["token"], answer["epoch"], None
        self.core.holders.add(self)
        if not self.core.main.is_up or self.core.main.generation != generation:
            self.lose("the connection to the gateway ended")
        elif self.terms.ttl_ms is not None:
            self._renewal = asyncio.create_task(self._renew(self.terms.ttl_ms / 3000))

    def _give_back(self, task: asyncio.Task[Any]) -> None:
        if not task.cancelled() and task.exception() is None and "token" in task.result():
            self._token = task.result()["token"]
            self._renewal = asyncio.create_task(self._release())

    async def close(self) -> None:
        """Gives the lease up: the gateway stops moving fingers, and a held part stays held."""
        if self._renewal is not None:
            self._renewal.cancel()
        self.core.holders.discard(self)
        if self._lost is None:
            self._lost = ("it was given up", None)
            await self._release()
        await self.losses.close()
        self.losses = self._new_losses()

    async def _release(self) -> None:
        with contextlib.suppress(GatewayError):  # The lease has ended already, or ends with the connection.
            await self.core.main.call("lease.release", gripper=self.gripper, lease=self._token)

    async def hand_over(self, to: str | None) -> None:
        """Gives the lease to the client that asked for it first, or to `to`."""
        if to is None:
            lease = Lease.build(await self.call("lease.renew"))
            to = lease.requested_by
        if to is None:
            raise ValueError(f"nobody asks for {self.gripper}: name the client in `to`")
        # The state of the new holder can come before the response.
        self.core.holders.discard(self)
        try:
            await self.call("lease.hand-over", to=to)
        except GatewayError:
            self.core.holders.add(self)
            raise
        self.lose("it was handed over", to)

    async def _renew(self, pause_s: float) -> None:
        while self.is_held:
            await asyncio.sleep(pause_s)
            with contextlib.suppress(GatewayError):  # A lost lease is noted by the call.
                await self.call("lease.renew")

    def check(self, state: State) -> None:
        """Notes a loss that a state of the gripper shows."""
        if state.gripper != self.gripper or not self.is_held:
            return
        if state.lease_epoch > self._epoch:
            self.lose("another client has it", state.lease_holder)
        elif state.lease_epoch == self._epoch and state.lease_holder is None:
            self.lose("it ended at the gateway")

    def lose(self, reason: str, holder: str | None = None) -> None:
        """Notes that the lease is lost, and reports it once."""
        if not self.is_held:
            return
        self._lost = (reason, holder)
        self.core.holders.discard(self)
        self.losses.put(self.loss())

    def loss(self) -> ControlLost:
        """Returns why the lease is lost."""
        reason, holder = self._lost or ("", None)
        return ControlLost(self.gripper, reason, holder)

    async def call(self, method: str, **params: Any) -> Any:
        """Sends a request that needs the lease."""
        if not self.is_held:
            raise self.loss()
        try:
            return await self.core.main.call(method, gripper=self.gripper, lease=self._token, **params)
        except Refused as refused:
            await self.core.stop_shown(self.gripper, refused.fast_stop_id)
            if refused.code != "stale_lease":
                raise
            self.lose("the gateway does not know it any more", refused.holder)
            raise self.loss() from refused

    async def notify(self, method: str, **params: Any) -> None:
        """Sends a request that needs the lease, and gets no answer."""
        await self.core.main.notify(method, gripper=self.gripper, lease=self._token, **params)

    async def move(self, kind: str, **params: Any) -> Motion:
        """Carries out a motion, and returns it when it has ended. Sends it once, whatever happens."""
        newest = self.core.latest.get(self.gripper)
        is_recorded = newest is not None and newest[0].journal_cause is None
        sending = Sending(kind, uuid.uuid4().hex, time.monotonic(), self.core.journal_id, is_recorded)
        generation = self.core.main.generation
        try:
            command = await self.call(kind, request_id=sending.request_id, **params)
        except ConnectionLost:
            command = await self._found(sending)
        except Unreachable as error:
            raise ControlLost(self.gripper, str(error)) from error
        while command["phase"] != "done":
            command = await self._next(command, sending, generation)
        if command["outcome"] == "REFUSED":
            raise Refused({"code": command.get("code", "device_refused"), "detail": command.get("detail", ""), "status": 409})
        return await self.core.result(command)

    async def _next(self, command: dict[str, Any], sending: Sending, generation: int) -> dict[str, Any]:
        """Returns what became of a running command."""
        link = self.core.main
        if link.is_up and link.generation == generation:
            ended = await self.core.ended(command["id"], READ_S)
        else:
            # Only the connection that started a command hears of its end.
            ended = None
            await asyncio.sleep(POLL_S)
        if ended is not None:
            return ended
        try:
            return dict(await link.call("command", gripper=self.gripper, command=command["id"]))
        except Unreachable:
            return await self._found(sending)
        except Refused as refused:
            return command if refused.code in PASSING else await self._found(sending)

    async def _found(self, sending: Sending) -> dict[str, Any]:
        """Finds a motion by its request id after its connection was lost. Starts nothing."""
        link, deadline = self.core.main, time.monotonic() + self.terms.patience_s
        is_lease_over = False
        while True:
            try:
                await link.up(max(deadline - time.monotonic(), 0))
                if not is_lease_over:
                    # While the old connection has the lease, the gateway may still read the motion from it.
                    lease = Lease.build(await link.call("lease", gripper=self.gripper))
                    is_lease_over = not (lease.held and lease.epoch == self._epoch)
                command = await link.call("command.latest", gripper=self.gripper, request_id=sending.request_id)
                return dict(command)
            except ConnectionLost as error:
                problem: GatewayError = error
            except Unreachable as error:
                return self._unknown(sending, f"{error}. Look at the gripper and the part")
            except Refused as refused:
                problem = refused
                if refused.code == "not_found" and is_lease_over:
                    return await self._missing(sending)
                if refused.code not in PASSING | {"not_found"}:
                    return self._unknown(sending, str(refused))
            if time.monotonic() >= deadline:
                return self._unknown(sending, str(problem))
            await asyncio.sleep(POLL_S)

    async def _missing(self, sending: Sending) -> dict[str, Any]:
        """Decides about a motion that the gateway does not know: it was not started, if the gateway can know that."""
        if not sending.is_recorded or sending.journal_id is None or sending.journal_id != self.core.journal_id:
            return self._unknown(sending, "the gateway was restarted with another journal, which does not know the motion")
        if time.monotonic() - sending.sent_at > IDS_KEPT_S:
            return self._unknown(sending, "the connection was lost for longer than the gateway keeps request ids")
        if await self._is_restored():
            return self._unknown(sending, "the journal was restored, and does not know the motion")
        raise ControlLost(self.gripper, f"the connection was lost before {sending.kind} reached the gateway")

    async def _is_restored(self) -> bool:
        try:
            alarms = (await self.core.main.call("alarms"))["alarms"]
        except GatewayError:
            return True  # Not known, so the worse of the two.
        return any(alarm["alarm"] == "journal_restored" for alarm in alarms)

    def _unknown(self, sending: Sending, detail: str) -> dict[str, Any]:
        command = {"id": "", "gripper": self.gripper, "kind": sending.kind, "phase": "done", "outcome": "UNKNOWN"}
        return {**command, "outcome_code": 10, "replayed": False, "detail": detail}
