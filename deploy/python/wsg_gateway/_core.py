"""The connections to a gateway, and the newest values that it has pushed."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

from ._address import Address
from ._errors import GatewayError, Refused, StopUnconfirmed
from ._link import Link
from ._model import Model, OtherEvent, parse_time
from ._stream import Queue
from ._types import EVENTS, GripRecord, Motion, State

logger = logging.getLogger("wsg_gateway")

TOPICS = ("state", "events", "grips")
# The response to a FAST STOP comes within 250 ms.
STOP_ANSWER_S = 0.5
# Refusals that no further request changes.
NEVER_STOPS = ("unauthorized", "forbidden", "not_found")
# A notification can be missing, so a command is also read now and then.
READ_S = 1.0
# Ends of commands that came before anybody waited for them.
KEPT_ENDS = 64
# A pushed state that shows a result comes soon after it. If it does not, the state is read.
SHOWN_S, LOOK_S = 0.2, 0.005


@dataclass(frozen=True)
class FastStop:
    """A FAST STOP that a gateway has received."""

    id: str
    """Id that an acknowledgement has to name."""
    confirmed: bool
    """Whether the flags of all grippers showed it within 250 ms. If not, the gateway keeps repeating it."""
    unconfirmed: tuple[str, ...]
    """Grippers that have not shown it yet."""


@dataclass(frozen=True)
class ClockOffset:
    """Difference between the gateway's clock and the one of this machine."""

    offset_s: float
    """Gateway minus this machine, in s: subtract it from `measured_at` to get the time on this machine."""
    bound_s: float
    """Largest possible error of the offset, in s."""


class Holder(Protocol):
    """A lease, as the connection sees it."""

    def check(self, state: State) -> None:
        """Compares the lease with a new state."""

    def lose(self, reason: str, holder: str | None = None) -> None:
        """Notes that the lease is lost."""

    async def close(self) -> None:
        """Gives the lease up."""


class Core:
    """Everything about one gateway that runs in the thread of the engine."""

    def __init__(self, address: Address, max_hz: int, topics: tuple[str, ...]) -> None:
        """Prepares the two connections."""
        self.address, self.max_hz, self.topics = address, max_hz, topics
        self.context = address.context()
        self.latest: dict[str, tuple[State, float]] = {}
        """Newest state of each gripper, and the time at which it arrived. Replaced as a whole, so that any thread can read it."""
        self.main = Link(address, self.context, self._notified, self._opened, self._closed)
        self.stops = Link(address, self.context)
        self.journal_id: str | None = None
        self.holders: set[Holder] = set()
        self.servos: set[Callable[[str, dict[str, Any] | None], None]] = set()
        """Take the name of a gripper, and the servo session that is open there, whenever the gateway pushes it."""
        self._subscribed = list(topics)
        self._queues: dict[str, set[Queue[Any]]] = {topic: set() for topic in TOPICS}
        self._waiting: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._ended: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._seqs: dict[str, int] = {}
        self._newest_grip: tuple[str, Any] | None = None
        # FAST STOPs have a thread of their own, so that no download delays them.
        self._threads, self._stop_threads = ThreadPoolExecutor(2, "wsg-http"), ThreadPoolExecutor(2, "wsg-fast-stop")

    async def open(self, timeout_s: float) -> None:
        """Connects. A refusal, for example of the token, is final."""
        self.main.start()
        self.stops.start()
        for link in (self.main, self.stops):
            await link.up(timeout_s, lambda error: isinstance(error, Refused))

    async def close(self) -> None:
        """Closes the connections, and ends all iterators."""
        for holder in list(self.holders):
            await holder.close()
        await asyncio.gather(self.main.stop(), self.stops.stop())
        for queues in self._queues.values():
            for queue in tuple(queues):
                await queue.close()
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._stop_threads.shutdown(wait=False, cancel_futures=True)

    async def get(self, path: str, timeout_s: float = 10.0, **query: Any) -> Any:
        """Reads something over HTTP, because the lists of the journal are not on the WebSocket."""
        return await self._http(self._threads, "GET", path, timeout_s, query)

    async def _http(self, threads: ThreadPoolExecutor, method: str, path: str, timeout_s: float, query: dict[str, Any]) -> Any:
        arguments = (method, f"/api/v1{path}", query, self.context, timeout_s)
        return await asyncio.get_running_loop().run_in_executor(threads, self.address.request, *arguments)

    async def fast_stop(self, gripper: str | None, reason: str | None, timeout_s: float) -> FastStop:
        """Triggers a FAST STOP. A read after it shows this FAST STOP."""
        stop = await self._fast_stop(gripper, reason, timeout_s)
        if self.main.is_up:
            names = [gripper] if gripper else list(self.latest)
            await asyncio.gather(*(self.stop_shown(name, stop.id) for name in names))
        return stop

    async def _fast_stop(self, gripper: str | None, reason: str | None, timeout_s: float) -> FastStop:
        """Sends a FAST STOP over its own connection, and over new ones if that does not answer."""
        deadline = time.monotonic() + timeout_s
        path = f"/grippers/{gripper}/fast-stop" if gripper else "/fast-stop"
        body = {"reason": reason} if reason else {}
        error: Exception
        while True:
            with contextlib.suppress(GatewayError):
                return stopped(await self.stops.call("fast-stop", STOP_ANSWER_S, gripper=gripper, reason=reason))
            try:
                answer = self._http(self._stop_threads, "POST", path, 2 * STOP_ANSWER_S, body)
                # The search for the host's address has no limit of its own.
                return stopped(await asyncio.wait_for(answer, 3 * STOP_ANSWER_S))
            except Refused as refused:
                if refused.code in NEVER_STOPS:
                    raise
                error = refused
            except (GatewayError, asyncio.TimeoutError, RuntimeError) as failed:
                # A RuntimeError means that another thread closes the gateway meanwhile.
                error = failed
            if time.monotonic() >= deadline:
                raise StopUnconfirmed(
                    f"no answer to the FAST STOP within {timeout_s:g} s ({error}): it is not known whether anything stopped; "
                    "use the hardware emergency stop"
                ) from error
            await asyncio.sleep(0.05)

    async def clock_offset(self, samples: int) -> ClockOffset:
        """Measures the offset of the gateway's clock, and returns the sample with the smallest bound."""
        measured = []
        for _ in range(max(samples, 1)):
            sent = time.time()
            answer = await self.main.call("clock")
            came = time.time()
            received_at, sent_at = (parse_time(answer[name]).timestamp() for name in ("received_at", "sent_at"))
            offset = ((received_at - sent) + (sent_at - came)) / 2
            # The gateway's times have microseconds.
            measured.append(ClockOffset(offset, max((came - sent) - (sent_at - received_at), 0) / 2 + 1e-6))
        return min(measured, key=lambda one: one.bound_s)

    async def stop(self, gripper: str) -> Motion:
        """Stops the fingers, and waits until the Stop has ended."""
        command = dict(await self.main.call("stop", gripper=gripper))
        while command["phase"] != "done":
            ended = await self.ended(command["id"], READ_S)
            command = ended or dict(await self.main.call("command", gripper=gripper, command=command["id"]))
        return await self.result(command)

    async def result(self, command: dict[str, Any]) -> Motion:
        """Builds the result of a motion. A read after it shows the FAST STOP that ended the motion."""
        motion = Motion.build(command)
        await self.stop_shown(motion.gripper, motion.fast_stop_id)
        return motion

    async def stop_shown(self, gripper: str, fast_stop_id: str | None) -> None:
        """Waits until the newest state shows a FAST STOP, if there was one."""
        if fast_stop_id is not None:
            await self._shown(gripper, lambda state: is_latched(state, fast_stop_id))

    async def acknowledge(self, gripper: str, fast_stop_id: str) -> None:
        """Acknowledges a FAST STOP. A read after it does not show this FAST STOP any more."""
        await self.main.call("acknowledge", gripper=gripper, fast_stop_id=fast_stop_id)
        await self._shown(gripper, lambda state: state.fast_stop is False or state.fast_stop_id not in (None, fast_stop_id))

    async def _shown(self, gripper: str, shows: Callable[[State], object]) -> None:
        """Waits until the newest state shows what a call has returned."""
        deadline = time.monotonic() + SHOWN_S
        while gripper in self.latest and not shows(self.latest[gripper][0]):
            if time.monotonic() >= deadline or not self.main.is_up:
                with contextlib.suppress(GatewayError):
                    self._stated(await self.main.call("state", READ_S, gripper=gripper))
                return
            await asyncio.sleep(LOOK_S)

    async def ended(self, command_id: str, timeout_s: float) -> dict[str, Any] | None:
        """Waits for the notification that a command has ended."""
        if command_id in self._ended:
            return self._ended.pop(command_id)
        future = self._waiting[command_id] = asyncio.get_running_loop().create_future()
        try:
            return await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            return None
        finally:
            del self._waiting[command_id]

    def queue(self, topic: str, gripper: str | None, size: int) -> Queue[Any]:
        """Adds a reader of a topic."""
        if topic not in self.topics:
            raise ValueError(f"topic {topic!r} is not subscribed: add it to `topics` of connect")
        queue: Queue[Any] = Queue(f"{topic} of {gripper or 'all grippers'}", gripper, size)
        self._queues[topic].add(queue)
        return queue

    async def end(self, queue: Queue[Any]) -> None:
        """Removes a reader."""
        for queues in self._queues.values():
            queues.discard(queue)
        await queue.close()

    async def _opened(self) -> None:
        """Subscribes, and finds out with which journal the gateway runs."""
        before, self.journal_id = self.journal_id, None
        if not self._subscribed:
            return
        self.journal_id = await self._journal_id()
        if None not in (before, self.journal_id) and before != self.journal_id:
            logger.warning("the gateway has another journal than before: its events and records begin again")
            self._seqs.clear()
        # Events of this connection can come before the answer is looked at.
        last = self._seqs.get("events")
        answer = await self._subscribe()
        self._count_missed("events", last, answer["event_seq"] + 1)
        self._seqs["events"] = max(answer["event_seq"], self._seqs.get("events", 0))
        for state in answer["states"]:
            self._stated(state)

    async def _subscribe(self) -> Any:
        return await self.main.call("subscribe", topics=self._subscribed, max_hz=self.max_hz)

    async def watch_servos(self) -> None:
        """Subscribes to the topic with servo sessions, too, from the first session on."""
        if "telemetry" not in self._subscribed:
            self._subscribed.append("telemetry")
            await self._subscribe()

    async def _journal_id(self) -> str | None:
        try:
            return str((await self.get("/grips", limit=1))["journal_id"])
        except GatewayError as error:
            logger.warning("the journal's id is not known (%s): the outcome of a motion can stay unknown after a restart", error)
            return None

    def _count_missed(self, topic: str, last: int | None, seq: int) -> None:
        """Counts the items that came while the connection was down: those between the last one and `seq`."""
        if last is not None and seq > last + 1:
            self._drop(topic, seq - last - 1, f"the connection was lost: read them with records.{topic}(after={last})")

    def _closed(self, reason: str) -> None:
        for holder in list(self.holders):
            holder.lose(reason)

    def _notified(self, method: str, params: dict[str, Any]) -> None:
        """Takes a notification."""
        if method == "state":
            self._stated(params)
        elif method == "telemetry":
            for take in tuple(self.servos):
                take(params["gripper"], params.get("servo"))
        elif method == "event":
            self._seqs["events"] = max(params["seq"], self._seqs.get("events", 0))
            self._put("events", params.get("gripper"), event(params))
        elif method == "grip":
            newest = (params["id"], params.get("part_lost_at"))
            if newest != self._newest_grip:  # A record can come twice around a subscription.
                self._newest_grip = newest
                last = self._seqs.get("grips")
                self._count_missed("grips", last, params["seq"])
                self._seqs["grips"] = max(params["seq"], last or 0)
                self._put("grips", params["gripper"], GripRecord.build(params))
        elif method == "gap":
            self._drop(params["topic"], params["missed"], "this connection is too slow")
            self._seqs.pop(params["topic"], None)
        elif method == "command":
            self._command_ended(params)

    def _stated(self, params: dict[str, Any]) -> None:
        state = State.build(params)
        self.latest[state.gripper] = (state, time.monotonic())
        for holder in list(self.holders):
            holder.check(state)
        self._put("state", state.gripper, state)

    def _command_ended(self, command: dict[str, Any]) -> None:
        waiting = self._waiting.get(command["id"])
        if waiting is not None and not waiting.done():
            waiting.set_result(command)
            return
        self._ended[command["id"]] = command
        if len(self._ended) > KEPT_ENDS:
            self._ended.popitem(last=False)

    def _put(self, topic: str, gripper: str | None, item: Model) -> None:
        for queue in tuple(self._queues[topic]):  # Other threads add readers.
            if queue.gripper in (None, gripper):
                queue.put(item)

    def _drop(self, topic: str, count: int, reason: str) -> None:
        for queue in tuple(self._queues.get(topic, ())):
            queue.drop(count, reason)


def is_latched(state: State, fast_stop_id: str) -> bool:
    """Whether a state shows a FAST STOP or a newer one. Newer ids are greater."""
    return state.fast_stop is not False and (state.fast_stop_id or "") >= fast_stop_id


def stopped(answer: dict[str, Any]) -> FastStop:
    """The result of a FAST STOP of one gripper or of all."""
    unconfirmed = answer.get("unconfirmed", [] if answer["fast_stop_confirmed"] else [answer.get("gripper")])
    return FastStop(answer["fast_stop_id"], answer["fast_stop_confirmed"], tuple(unconfirmed))


def event(params: dict[str, Any]) -> Model:
    """An event of its kind."""
    kind = EVENTS.get(params["kind"])
    return kind.build(params) if kind else OtherEvent("other", params.get("gripper"), params["seq"], params)
