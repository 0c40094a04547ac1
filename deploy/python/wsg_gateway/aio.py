"""Use of a gateway with asyncio. The synchronous module has the same names."""

from __future__ import annotations

import contextlib
import os
import ssl
import time
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from ._address import Address
from ._call_aio import Opening, call, follow, opened
from ._control import ControlCore, Terms
from ._core import TOPICS, ClockOffset, Core, FastStop
from ._engine import Engine, EngineClosed
from ._errors import ControlLost, StreamEnded
from ._reads import Reads
from ._records import Records as RecordsCore
from ._servo import Steering
from ._stream import Queue
from ._types import (
    Curve,
    Direction,
    Event,
    EventKind,
    GripKinds,
    GripRecord,
    Info,
    Motion,
    OnBlock,
    OnLossHolding,
    OnLossMoving,
    Outcome,
    ProposedLimits,
    Recipe,
    ServoAdapter,
    State,
)

T = TypeVar("T")


def connect(
    url: str,
    *,
    token: str | None = None,
    tls: ssl.SSLContext | str | os.PathLike[str] | None = None,
    unknown: Literal["none", "raise"] = "none",
    stale_after_s: float = 2.0,
    max_hz: int = 50,
    topics: Iterable[str] = TOPICS,
    timeout_s: float = 5.0,
) -> Opening[Gateway]:
    """Connects to the gateway at `url`, such as `http://127.0.0.1:8080`.

    `token` is a credential, and `tls` the certificate authority to trust: a file, or an `ssl.SSLContext`. `unknown` says
    what a read returns for a value that is not known or older than `stale_after_s`. `max_hz` (1 to 100) is the rate of
    the pushed states. `topics` can be empty for a client with the role `stop`, which may not read.

    Raises `Unreachable` if no gateway answers within `timeout_s`, and `Refused` if it refuses the token.
    """
    address = Address(url, token, tls)
    return opened(Gateway(Core(address, max_hz, tuple(topics)), unknown == "raise", stale_after_s, timeout_s))


def refuse_motion(method: str) -> None:
    """Keeps motions to the methods that send them once and wait for their end."""
    if method in ("home", "move", "grip", "release"):
        raise ValueError(f"{method} is a motion: call {method}() of a gripper under control")


class Gateway:
    """A connection to a gateway. `gateway["left"]` is one of its grippers."""

    def __init__(self, core: Core, is_strict: bool, stale_after_s: float, timeout_s: float) -> None:
        """Use `connect`."""
        self._core, self._is_strict, self._stale_after_s, self._timeout_s = core, is_strict, stale_after_s, timeout_s
        self._engine = Engine()
        self.records = Records(core, self._engine)
        """Grips, curves and events of the journal."""
        self.recipes = Recipes(core, self._engine)
        """Recipes of parts."""

    async def open(self) -> None:
        """Opens the connections. `connect` has done so already."""
        try:
            await call(self._engine, self._core.open(self._timeout_s))
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Gives up all leases, and closes the connections. Does nothing if they are closed already."""
        with contextlib.suppress(EngineClosed):
            try:
                await call(self._engine, self._core.close())
            finally:
                self._engine.stop()

    async def __aenter__(self) -> Gateway:
        """Returns the gateway, which is open."""
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Closes the gateway."""
        await self.close()

    @property
    def connected(self) -> bool:
        """Whether the main connection is up."""
        return self._core.main.is_up

    @property
    def grippers(self) -> dict[str, Gripper]:
        """The grippers by their names."""
        return {name: self[name] for name in list(self._core.latest)}

    def __getitem__(self, name: str) -> Gripper:
        """Returns the gripper with this name, or raises `KeyError`."""
        if self._core.topics and name not in self._core.latest:
            raise KeyError(f"no gripper {name!r}: this gateway has {', '.join(sorted(self._core.latest)) or 'none'}")
        return Gripper(self._core, self._engine, name, self._is_strict, self._stale_after_s)

    async def fast_stop(self, reason: str | None = None, timeout_s: float = 5.0) -> FastStop:
        """Triggers a FAST STOP on all grippers of the gateway. It is not a safety function.

        It has a connection of its own, and works from any thread while a motion is awaited. If there is no answer, it is
        sent again on new connections. Raises `StopUnconfirmed` if nothing answered within `timeout_s`, and `Refused`.
        """
        return await call(self._engine, self._core.fast_stop(None, reason, timeout_s))

    async def clock_offset(self, samples: int = 8) -> ClockOffset:
        """Measures the difference between the gateway's clock and the one of this machine."""
        return await call(self._engine, self._core.clock_offset(samples))

    async def request(self, method: str, **params: Any) -> Any:
        """Sends any other request of the WebSocket, such as `alarms`, and returns its result as JSON.

        Raises `ValueError` for a motion, which would have no id here.
        """
        refuse_motion(method)
        return await call(self._engine, self._core.main.call(method, **params))

    def telemetry(self, size: int = 256) -> Stream[State]:
        """Iterates over the states of all grippers as they are pushed. Keeps the newest `size` ones."""
        return Stream(self._core, self._engine, self._core.queue("state", None, size))

    def events(self, size: int = 1024) -> Stream[Event]:
        """Iterates over all events from now on."""
        return Stream(self._core, self._engine, self._core.queue("events", None, size))

    def grips(self, size: int = 256) -> Stream[GripRecord]:
        """Iterates over the records of all motions as they are written; a record comes again if its part was lost."""
        return Stream(self._core, self._engine, self._core.queue("grips", None, size))


class Gripper(Reads):
    """A gripper: its newest values, and what needs no lease. `control` gives the right to move it."""

    def __init__(self, core: Core, engine: Engine, name: str, is_strict: bool, stale_after_s: float) -> None:
        """Use `gateway[name]`."""
        super().__init__(core, name, is_strict, stale_after_s)
        self._engine = engine

    def control(
        self,
        holder: str | None = None,
        *,
        on_loss_moving: OnLossMoving | None = None,
        on_loss_holding: OnLossHolding | None = None,
        if_held: Literal["wait", "request", "fail"] = "wait",
        timeout_s: float = 5.0,
        ttl_ms: int | None = None,
        force: bool = False,
        speed_mm_s: float = 50.0,
        patience_s: float = 30.0,
        on_lost: Callable[[ControlLost], Any] | None = None,
    ) -> Control:
        """Takes the lease for a block, in which the gripper can be moved. The end of the block gives it up.

        `holder` is the name that others see. `on_loss_…` says what happens if this program or its connection fails, by
        default what the gateway's configuration says. If another client holds the lease, `if_held` waits for it, asks
        for a hand-over, or fails, for up to `timeout_s`. `force` takes it away, as a supervisor.

        The lease lasts as long as the connection. The package keeps it in a thread of its own: a program that hangs
        elsewhere keeps it. The gateway notices a frozen process after 3 s; with `ttl_ms`, after that time.

        `speed_mm_s` is the speed of motions without one. After a lost connection, a motion looks for its result for up
        to `patience_s`. `on_lost` is called once if the lease is lost.
        """
        terms = Terms(holder, on_loss_moving, on_loss_holding, if_held, timeout_s, ttl_ms, force, patience_s)
        return Control(self._core, self._engine, self.name, self._is_strict, self._stale_after_s, terms, speed_mm_s, on_lost)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Says what is missing for a motion."""
            remedy = f": take control first, with {self.name}.control() as gripper" if hasattr(Control, name) else ""
            raise AttributeError(f"{type(self).__name__} has no {name!r}{remedy}", name=name, obj=self)

    async def stop(self) -> Motion:
        """Stops the fingers, whoever moves them. No FAST STOP is latched, and no lease is needed."""
        return await call(self._engine, self._core.stop(self.name))

    async def fast_stop(self, reason: str | None = None, timeout_s: float = 5.0) -> FastStop:
        """Triggers a FAST STOP on this gripper: see `Gateway.fast_stop`."""
        return await call(self._engine, self._core.fast_stop(self.name, reason, timeout_s))

    async def acknowledge(self, fast_stop_id: str) -> None:
        """Acknowledges a FAST STOP, whose id is in `state.fast_stop_id`. Moves nothing.

        Call it only when a person has removed the cause, and has made sure that nobody is near the fingers.
        """
        await call(self._engine, self._core.acknowledge(self.name, fast_stop_id))

    async def info(self) -> Info:
        """Reads what the gripper is, and its limits."""
        return Info.build(await self._request("info"))

    async def wait_for(self, predicate: Callable[[State], object], timeout_s: float | None = None) -> State:
        """Waits until the predicate is true for a pushed state, and returns this state.

        A value of the state can be `None`. States that last for less than 1/`max_hz` can be missed. Raises
        `TimeoutError` after `timeout_s`.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        newest = self._newest()
        async with self.telemetry(1) as states:
            while newest is None or not predicate(newest):
                remaining = None if deadline is None else max(deadline - time.monotonic(), 0)
                newest = await states.next(remaining)
            return newest

    def telemetry(self, size: int = 256) -> Stream[State]:
        """Iterates over the states of this gripper as they are pushed. Keeps the newest `size` ones."""
        return Stream(self._core, self._engine, self._core.queue("state", self.name, size))

    def events(self, size: int = 1024) -> Stream[Event]:
        """Iterates over the events of this gripper from now on."""
        return Stream(self._core, self._engine, self._core.queue("events", self.name, size))

    def grips(self, size: int = 256) -> Stream[GripRecord]:
        """Iterates over the records of this gripper as they are written."""
        return Stream(self._core, self._engine, self._core.queue("grips", self.name, size))

    async def _request(self, method: str, **params: Any) -> Any:
        return await call(self._engine, self._core.main.call(method, gripper=self.name, **params))


class Control(Gripper):
    """The lease of a gripper, for a block. Motions return when they have ended; they are sent once, and never repeated.

    A motion raises `Refused` if it was refused, and `ControlLost` if the lease is lost: nothing has moved then. It
    returns the outcome `UNKNOWN` if nobody can know what happened: look at the gripper and the part.
    """

    def __init__(
        self,
        core: Core,
        engine: Engine,
        name: str,
        is_strict: bool,
        stale_after_s: float,
        terms: Terms,
        speed_mm_s: float,
        on_lost: Callable[[ControlLost], Any] | None,
    ) -> None:
        """Use `Gripper.control`."""
        super().__init__(core, engine, name, is_strict, stale_after_s)
        self._lease, self._speed_mm_s, self._on_lost = ControlCore(core, name, terms), speed_mm_s, on_lost

    async def __aenter__(self) -> Control:
        """Takes the lease. Raises `Refused`, or `TimeoutError` if nobody hands it over."""
        await call(self._engine, self._lease.take())
        if self._on_lost is not None:
            follow(self._engine, self._lease.losses, self._on_lost)
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Gives the lease up: moving fingers are stopped, and a held part stays held."""
        with contextlib.suppress(EngineClosed):  # The gateway was closed, which has given the lease up.
            await call(self._engine, self._lease.close())

    @property
    def held(self) -> bool:
        """Whether the lease is held, as far as this program knows."""
        return self._lease.is_held

    async def hand_over(self, to: str | None = None) -> None:
        """Hands the lease over to the client that asked for it first, or to the holder name `to`."""
        await call(self._engine, self._lease.hand_over(to))

    async def home(self, direction: Direction | None = None, if_needed: bool = False) -> Motion | None:
        """Finds the end stop. With `if_needed`, asks first, and returns `None` if the gripper is referenced."""
        if if_needed and (await self._request("state"))["referenced"]:
            return None
        return await self._motion("home", direction=direction)

    async def move(
        self, width_mm: float, speed_mm_s: float | None = None, *, relative: bool = False, on_block: OnBlock | None = None
    ) -> Motion:
        """Moves the fingers to a width in mm, or by a change of the width if `relative`, at a speed in mm/s."""
        speed = self._speed_mm_s if speed_mm_s is None else speed_mm_s
        return await self._motion("move", width_mm=width_mm, speed_mm_s=speed, relative=relative or None, on_block=on_block)

    async def grip(
        self,
        width_mm: float | None = None,
        speed_mm_s: float | None = None,
        force_n: float | None = None,
        *,
        part_id: str | int | None = None,
        recipe: int | None = None,
        recipe_version: int | None = None,
        reference: bool = False,
    ) -> Motion:
        """Grips a part of a width in mm, at a speed in mm/s, with a force limit in N.

        Without `width_mm`, the values are those of the recipe of `part_id`, or of the recipe with the number `recipe`.
        With `width_mm`, a recipe is used only if `recipe` names it. Send a force with each grip: the gripper keeps the
        last one, which may be that of another client.
        """
        speed = self._speed(width_mm, speed_mm_s, recipe)
        return await self._motion(
            "grip",
            width_mm=width_mm,
            speed_mm_s=speed,
            force_n=force_n,
            part_id=part_id,
            recipe=recipe,
            recipe_version=recipe_version,
            reference=reference or None,
        )

    async def release(
        self,
        width_mm: float | None = None,
        speed_mm_s: float | None = None,
        *,
        part_id: str | int | None = None,
        recipe: int | None = None,
    ) -> Motion:
        """Opens the fingers to a width in mm, at a speed in mm/s, or as a recipe says: see `grip`."""
        speed = self._speed(width_mm, speed_mm_s, recipe)
        return await self._motion("release", width_mm=width_mm, speed_mm_s=speed, part_id=part_id, recipe=recipe)

    def servo(
        self,
        *,
        max_speed_mm_s: float = 100.0,
        timeout_ms: int = 200,
        force_n: float | None = None,
        adapter: ServoAdapter | None = None,
    ) -> Servo:
        """Steers the fingers by many targets a second, for a block: the newest target wins. It is not a safety function.

        `max_speed_mm_s` is the greatest speed in mm/s. Without a target for `timeout_ms` (20 to 10,000 ms), the gateway
        stops the fingers and ends the session. `force_n` is the force limit in N. `adapter` says how targets reach the
        fingers, by default as the gateway's configuration says. Other motions are refused meanwhile.
        """
        terms = {"max_speed_mm_s": max_speed_mm_s, "timeout_ms": timeout_ms, "force_n": force_n, "adapter": adapter}
        return Servo(self._engine, self._lease, terms)

    async def acknowledge_fault(self) -> None:
        """Acknowledges a fault without a FAST STOP. Moves nothing. Call it only when a person says so."""
        await self.command("acknowledge")

    async def command(self, method: str, **params: Any) -> Any:
        """Sends another request that needs the lease, such as `settings.force-limit.set`, and returns its result as JSON.

        Raises `ValueError` for a motion, which would have no id here.
        """
        refuse_motion(method)
        return await call(self._engine, self._lease.call(method, **params))

    def _speed(self, width_mm: float | None, speed_mm_s: float | None, recipe: int | None) -> float | None:
        """The speed to send. A request without a width or with a recipe can have its speed from there."""
        return self._speed_mm_s if speed_mm_s is None and width_mm is not None and recipe is None else speed_mm_s

    async def _motion(self, kind: str, **params: Any) -> Motion:
        return await call(self._engine, self._lease.move(kind, **params))


class Servo(Steering):
    """A servo session, for a block. Its end stops the fingers and waits until they stand still, also after an exception."""

    async def __aenter__(self) -> Servo:
        """Begins the session. Raises `Refused`, or `ControlLost` if the lease is lost."""
        await call(self._engine, self._begin())
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Ends the session, and stops the fingers. If the gateway does not answer, silence does this."""
        with contextlib.suppress(EngineClosed):  # The gateway was closed, which has given the lease up.
            await call(self._engine, self._end())


class Stream(Generic[T]):
    """An iterator over pushed items. It keeps a bounded number: `dropped` counts the items that are missing."""

    def __init__(self, core: Core, engine: Engine, queue: Queue[T]) -> None:
        """Use `telemetry`, `events` or `grips`."""
        self._core, self._engine, self._queue = core, engine, queue

    @property
    def dropped(self) -> int:
        """Number of items that are missing: this program was too slow, or the connection was lost."""
        return self._queue.dropped

    async def __aenter__(self) -> Stream[T]:
        """Returns the stream, which the end of the block closes."""
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Closes the stream."""
        await self.close()

    def __aiter__(self) -> Stream[T]:
        """Returns the stream itself."""
        return self

    async def __anext__(self) -> T:
        """Waits for the next item."""
        try:
            return await call(self._engine, self._queue.next())
        except (StreamEnded, EngineClosed):
            raise StopAsyncIteration from None

    async def next(self, timeout_s: float | None = None) -> T:
        """Waits for the next item. Raises `TimeoutError` after `timeout_s`, and `StreamEnded` after `close`."""
        return await call(self._engine, self._queue.next(timeout_s))

    def follow(self, callback: Callable[[T], Any]) -> Stream[T]:
        """Calls back for each item, until the stream is closed. An error of the callback is logged."""
        follow(self._engine, self._queue, callback)
        return self

    async def close(self) -> None:
        """Ends the stream."""
        with contextlib.suppress(EngineClosed):
            await call(self._engine, self._core.end(self._queue))


class Records:
    """The journal: grips with their curves, and events."""

    def __init__(self, core: Core, engine: Engine) -> None:
        """Use `gateway.records`."""
        self._records, self._engine = RecordsCore(core), engine

    async def grips(
        self,
        limit: int | None = 100,
        *,
        gripper: str | None = None,
        part_id: str | None = None,
        outcome: Outcome | None = None,
        kind: GripKinds | None = None,
        since: str | None = None,
        until: str | None = None,
        after: int | None = None,
    ) -> list[GripRecord]:
        """Reads grip records, newest first; with `after`, those after that `seq`, oldest first.

        `since` and `until` are times with a time zone, such as `2026-11-21T09:00:00Z`. A `limit` of `None` reads all.
        """
        filters = {"gripper": gripper, "part_id": part_id, "outcome": outcome, "kind": kind, "from": since, "to": until}
        return await call(self._engine, self._records.grips(limit, after, filters))

    async def grip(self, command_id: str, timeout_s: float = 0.0) -> GripRecord:
        """Reads one record by the id of its motion.

        A grip's record is written a second after its end: waits up to `timeout_s` for it, and then raises `Refused`.
        """
        return await call(self._engine, self._records.grip(command_id, timeout_s))

    async def curve(self, command_id: str, timeout_s: float = 0.0) -> Curve:
        """Reads the curve of a motion, whose fields are columns: `t_ms`, `width_mm`, `speed_mm_s`, `force_n`.

        Waits like `grip`.
        """
        return await call(self._engine, self._records.curve(command_id, timeout_s))

    async def events(
        self,
        limit: int | None = 100,
        *,
        gripper: str | None = None,
        kind: EventKind | None = None,
        since: str | None = None,
        until: str | None = None,
        after: int | None = None,
    ) -> list[Event]:
        """Reads events, newest first; with `after`, those after that `seq`, oldest first."""
        filters = {"gripper": gripper, "kind": kind, "from": since, "to": until}
        return await call(self._engine, self._records.events(limit, after, filters))


class Recipes:
    """The recipes of the gateway, which all its clients share."""

    def __init__(self, core: Core, engine: Engine) -> None:
        """Use `gateway.recipes`."""
        self._core, self._engine = core, engine

    async def list(self) -> list[Recipe]:
        """Reads all recipes."""
        return [Recipe.build(recipe) for recipe in (await self._request("recipes"))["recipes"]]

    async def get(self, part_id: str) -> Recipe:
        """Reads the recipe of a part. Raises `Refused` with `not_found` if it has none."""
        return Recipe.build(await self._request("recipe", part_id=part_id))

    async def set(self, part_id: str, number: int, *, if_version: int | None = None, **values: Any) -> Recipe:
        """Sets the recipe of a part as a whole: a value that is left out is cleared.

        `values` are `width_mm`, `speed_mm_s`, `force_n`, `accept_min_mm`, `accept_max_mm`, `release_width_mm`,
        `release_speed_mm_s`, `description` and `grippers`. `if_version` is the version that you have read; 0 only
        creates a recipe. Raises `Refused` with `precondition_failed` if somebody has changed it meanwhile.
        """
        return Recipe.build(await self._request("recipe.set", part_id=part_id, number=number, if_version=if_version, **values))

    async def remove(self, part_id: str, *, if_version: int | None = None) -> None:
        """Removes the recipe of a part."""
        await self._request("recipe.remove", part_id=part_id, if_version=if_version)

    async def teach(
        self, part_id: str, *, last: int | None = None, k: float | None = None, gripper: str | None = None
    ) -> ProposedLimits:
        """Proposes limits of the contact width from the `last` good grips of a part. Changes nothing."""
        answer = await self._request("recipe.teach", part_id=part_id, last=last, k=k, gripper=gripper)
        return ProposedLimits.build(answer)

    async def _request(self, method: str, **params: Any) -> Any:
        return await call(self._engine, self._core.main.call(method, **params))
