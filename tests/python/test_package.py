"""The package against a gateway with simulated grippers."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from gateways import Gateway, freeze, running, thaw, until
from wsg_gateway import (
    ControlLost,
    Motion,
    Refused,
    StopUnconfirmed,
    UnexpectedOutcome,
    Unreachable,
    ValueUnknown,
    columns,
)
from wsg_gateway._model import parse_time

Connect = Callable[..., Any]


def requests(gateway: Any) -> int:
    """Number of requests that this client has sent."""
    return next(gateway._core.main._ids)


def test_grip_cycle(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control("cell-7") as gripper:
        assert gripper.home(if_needed=True) is None
        gripper.release(60, 300)
        grip = gripper.grip(width_mm=20, speed_mm_s=200, force_n=30, part_id="A-1")
        assert (grip.outcome, grip.kind, grip.ok) == ("PART_HELD", "grip", True)
        assert grip.width_mm == pytest.approx(19.85, abs=0.1)
        until(lambda: gripper.holding)
        assert gripper.release(60, 300).outcome == "SUCCESS"


def test_no_part_is_a_result_and_a_refusal_is_an_exception(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["right"].control() as gripper:
        gripper.release(60, 300)
        grip = gripper.grip(20, 400)
        assert grip.outcome == "NO_PART" and not grip.ok
        with pytest.raises(UnexpectedOutcome, match="grip of right ended as NO_PART"):
            grip.expect()
        assert grip.expect("PART_HELD", "NO_PART") is grip
        gripper.release(60, 300)
        with pytest.raises(Refused, match="out_of_range.*110") as refused:
            gripper.move(5000)
        assert (refused.value.code, refused.value.field, refused.value.max) == ("out_of_range", "width_mm", 110)
        with pytest.raises(Refused) as refused:
            gripper.grip(recipe=99)
        assert refused.value.code in ("not_found", "malformed", "out_of_range")


def test_reads_send_no_request(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client:
        left, before = client["left"], requests(client)
        for _ in range(10_000):
            assert left.width_mm is not None
        assert requests(client) == before + 1
        assert left.age < 2 and left.measured_at.tzinfo is not None
        assert left.link == "connected" and left.referenced is True and left.fast_stop_latched is False


def test_values_of_a_frozen_gateway_become_unknown(connect: Connect) -> None:
    gateway = Gateway()
    with running(gateway), connect(gateway.url, stale_after_s=1.5) as client, connect(gateway.url, unknown="raise") as strict:
        left = client["left"]
        assert left.speed_mm_s == 0
        assert strict["left"].speed_mm_s == 0
        with pytest.raises(ValueUnknown, match="width_mm of left"):
            _ = strict["left"].width_mm  # not referenced
        freeze(gateway)
        until(lambda: left.speed_mm_s is None, 3)
        until(lambda: left.state is None, 1)
        assert left.moving is None and left.fast_stop_latched is None and left.link is None
        until(lambda: not client.connected)
        with pytest.raises(Unreachable), left.control(timeout_s=0.1):
            pass
        with pytest.raises(StopUnconfirmed, match="hardware emergency stop"):
            client.fast_stop(timeout_s=0.1)
        thaw(gateway)
        until(lambda: left.speed_mm_s == 0)


def test_wait_for(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        gripper.move(60, 400)
        assert gripper.wait_for(lambda state: state.width_mm > 59, 1).state is not None
        with pytest.raises(TimeoutError, match="state of left"):
            gripper.wait_for(lambda state: state.width_mm < 10, 0.1)
        with pytest.raises(ZeroDivisionError):
            gripper.wait_for(lambda state: 1 / 0, 1)


def test_iterators_and_callbacks(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        events, telemetry, grips, seen = gripper.events(), gripper.telemetry(), client.grips(), []
        follower = client.grips().follow(seen.append)
        move = gripper.move(50, 400)
        phases: list[str] = []
        while len(phases) < 2:
            event = events.next(2)
            phases += [event.phase] if event.kind == "command" else []
        assert phases == ["admitted", "done"]
        assert next(iter(telemetry)).gripper == "left"
        assert grips.next(3).id == move.id
        until(lambda: [record.id for record in seen] == [move.id])
        gripper.move(60, 400)
        until(lambda: len(seen) == 2)
        for stream in (events, telemetry, grips, follower):
            stream.close()
        assert events.dropped == 0
    events.close()
    assert list(events) == []


def test_slow_reader_is_told_what_it_missed(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        events = client.events(size=2)
        gripper.move(50, 400)
        gripper.move(60, 400)
        until(lambda: events.dropped >= 2)
        assert events.next(1).kind == "command"


def test_events_during_a_lost_connection_are_counted(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client:
        events = client.events()
        client._core.main._socket.transport.abort()
        until(lambda: not client.connected)
        gateway.post("/grippers/left/move", width_mm=55, speed_mm_s=400)
        until(lambda: client.connected)
        gateway.post("/grippers/left/move", width_mm=60, speed_mm_s=400)
        until(lambda: events.next(2).kind == "command")
        newest = client.records.events(1)[0]
        missed = client.records.events(None, after=newest.seq - 5)
        assert [event.seq for event in missed][-1] >= newest.seq


def test_missed_events_are_counted_beside_newer_ones(connect: Connect, gateway: Gateway) -> None:
    """Events of a new connection can come before this program has looked at the answer of its subscription."""

    def newest() -> int:
        return int(gateway.get("/events?limit=1")["events"][0]["seq"])

    def move(width_mm: float) -> None:
        before = newest()
        gateway.post("/grippers/left/move", width_mm=width_mm, speed_mm_s=400)
        until(lambda: newest() > before)

    with connect(gateway.url) as client:
        seqs: list[int] = []
        events = client.events().follow(lambda event: seqs.append(event.seq))
        move(50)
        until(lambda: seqs and seqs[-1] == newest())
        last, core = seqs[-1], client._core
        subscribe = core._subscribe

        async def subscribe_slowly() -> Any:
            loop = asyncio.get_running_loop()
            await loop.run_in_executor(None, move, 55)
            answer = await subscribe()
            newer = core.queue("events", None, 100)
            await loop.run_in_executor(None, move, 60)
            await newer.next(5)
            await core.end(newer)
            return answer

        core._subscribe = subscribe_slowly
        client._engine.loop.call_soon_threadsafe(core.main._socket.transport.abort)
        until(lambda: core.main.generation == 2 and seqs[-1] > last)
        first = next(seq for seq in seqs if seq > last)
        assert events.dropped == first - last - 1 > 0


def test_control_fails_waits_or_asks(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as first, connect(gateway.url) as second:
        with first["left"].control("one") as one:
            with pytest.raises(Refused, match="lease_held") as refused, second["left"].control("two", if_held="fail"):
                pass
            assert refused.value.holder == "one"
            with pytest.raises(Refused, match="lease_held"), second["left"].control("two", timeout_s=0.3):
                pass
            with pytest.raises(TimeoutError, match="one did not hand left over"):
                second["left"].control("two", if_held="request", timeout_s=0.3).__enter__()
            taken = threading.Thread(target=lambda: holds(second["left"].control("two", if_held="request")))
            taken.start()
            one.hand_over("two")
            taken.join()
            with pytest.raises(ControlLost, match="handed over"):
                one.move(50)
        with contextlib.ExitStack() as stack:
            stack.enter_context(first["left"].control("one"))
            threading.Timer(0.3, stack.pop_all().close).start()
            with second["left"].control("two") as two:
                assert two.held


def holds(control: Any) -> None:
    with control as gripper:
        assert gripper.held


def test_control_that_is_taken_away_is_lost(connect: Connect, gateway: Gateway) -> None:
    lost: list[ControlLost] = []
    with connect(gateway.url) as client, client["left"].control("one", on_lost=lost.append) as gripper:
        gateway.post("/grippers/left/lease", holder="boss", force=True)
        until(lambda: lost)
        assert lost[0].holder == "boss" and not gripper.held
        before = gateway.state()["last_command"]
        with pytest.raises(ControlLost, match="another client has it"):
            gripper.move(50)
        assert gateway.state()["last_command"] == before
        gateway.post("/grippers/left/lease", holder="boss", force=True, ttl_ms=100)
        until(lambda: gateway.state()["lease_holder"] is None)


def test_exception_gives_control_up_and_stops_the_fingers(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client:
        motion: list[Any] = []
        with pytest.raises(ZeroDivisionError), client["left"].control() as gripper:
            gripper.move(20.5, 400)
            thread = threading.Thread(target=lambda: motion.append(gripper.move(100, 20)))
            thread.start()
            gripper.wait_for(lambda state: state.moving, 2)
            _ = 1 / 0
        thread.join()
        assert motion[0].outcome == "ABORTED"
        state = until(lambda: not (now := gateway.state())["moving"] and now)
        assert state["lease_holder"] is None and state["fast_stop"] is False


def test_lease_with_a_ttl_is_renewed(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control(ttl_ms=1000) as gripper:
        # A busy machine can hold up this program for longer than a shorter lease.
        time.sleep(3.5)
        assert gripper.held and gripper.move(50, 400).ok


def test_gateway_that_another_thread_closes_ends_the_control(connect: Connect, gateway: Gateway) -> None:
    client = connect(gateway.url)
    ended: list[Any] = []
    closed = threading.Event()

    def work() -> None:
        with client["left"].control() as gripper:
            gripper.move(30, 400)
            closed.set()
            ended.append(gripper.move(100, 10))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    until(lambda: closed.is_set() and client["left"].moving and (client["left"].width_mm or 0) > 31)
    client.close()
    thread.join(5)
    # The end of the motion may come after that of the connection.
    assert not thread.is_alive() and ended[0].outcome in ("ABORTED", "UNKNOWN")
    until(lambda: not gateway.state()["moving"] and gateway.state()["lease_holder"] is None)
    assert not gateway.state()["fast_stop"]


def test_unknown_journal_is_not_called_another_one(
    connect: Connect, gateway: Gateway, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def unknown() -> None:
        return None

    with connect(gateway.url) as client:
        core = client._core
        monkeypatch.setattr(core, "_journal_id", unknown)
        client._engine.loop.call_soon_threadsafe(core.main._socket.transport.abort)
        until(lambda: core.main.is_up and core.main.generation == 2)
        assert "another journal" not in caplog.text


def test_fast_stop_while_a_motion_is_awaited(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        gripper.move(30, 400)
        motion: list[Any] = []
        thread = threading.Thread(target=lambda: motion.append(gripper.move(100, 20)))
        thread.start()
        # The state can still say that the fingers move because of the motion before.
        gripper.wait_for(lambda state: state.moving and (state.width_mm or 0) > 31, 5)
        started = time.monotonic()
        stop = client.fast_stop("a test")
        assert stop.confirmed and time.monotonic() - started < 1
        thread.join()
        assert motion[0].outcome == "ABORTED" and motion[0].fast_stop_id == stop.id
        with pytest.raises(UnexpectedOutcome, match=f"ABORTED by FAST STOP {stop.id}: remove its cause"):
            motion[0].expect()
        with pytest.raises(Refused, match="fast_stop"):
            gripper.move(50)
        assert gripper.fast_stop_latched
        gripper.acknowledge(stop.id)
        assert gripper.fast_stop_latched is False


@pytest.mark.parametrize("max_hz", [1, 50])
def test_reads_after_a_call_show_its_fast_stop(connect: Connect, gateway: Gateway, max_hz: int) -> None:
    with connect(gateway.url, max_hz=max_hz) as client, client["left"].control() as gripper:
        for _ in range(3):
            gripper.move(50, 400)
            stopper = threading.Timer(0.2, gateway.post, ["/fast-stop"])
            stopper.start()
            motion = gripper.move(100, 20)
            assert motion.outcome == "ABORTED" and gripper.fast_stop_latched
            stopper.join()
            assert gripper.state.fast_stop_id == motion.fast_stop_id
            gripper.acknowledge(motion.fast_stop_id)
            assert gripper.fast_stop_latched is False
            gateway.post("/fast-stop")
            with pytest.raises(Refused, match="fast_stop"):
                gripper.move(50, 400)
            assert gripper.fast_stop_latched
            stop = client.fast_stop()
            assert all(one.fast_stop_latched for one in client.grippers.values())
            for one in client.grippers.values():
                one.acknowledge(stop.id)
                assert one.fast_stop_latched is False


@pytest.mark.parametrize("lost", ["main", "both"])
def test_fast_stop_without_the_connections(connect: Connect, gateway: Gateway, lost: str) -> None:
    with connect(gateway.url) as client:
        links = [client._core.main] + ([client._core.stops] if lost == "both" else [])
        for link in links:
            client._engine.submit(link.stop()).result()
        stop = client["left"].fast_stop()
        assert stop.confirmed and gateway.state()["fast_stop_id"] == stop.id


def test_stop_needs_no_lease(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, connect(gateway.url) as other, client["left"].control() as gripper:
        gripper.move(30, 400)
        timer = threading.Timer(0.3, lambda: stopped.append(other["left"].stop()))
        stopped: list[Any] = []
        timer.start()
        assert gripper.move(100, 20).outcome == "ABORTED"
        timer.join()
        assert stopped[0].outcome == "SUCCESS"


def test_recipes(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        recipe = client.recipes.set("A-1047", 12, width_mm=20, speed_mm_s=300, force_n=30, release_width_mm=35, accept_max_mm=21)
        assert client.recipes.get("A-1047") == recipe and recipe in client.recipes.list()
        with pytest.raises(Refused, match="precondition_failed"):
            client.recipes.set("A-1047", 12, if_version=0)
        gripper.release(60, 400)
        assert gripper.grip(part_id="A-1047").outcome == "PART_HELD"
        assert gripper.release(recipe=12).ok
        record = until(lambda: client.records.grips(1, part_id="A-1047"), 3)[0]
        assert record.recipe == 12 and record.requested_speed_mm_s == 300
        with pytest.raises(Refused, match="fewer than two grips|precondition"):
            client.recipes.teach("A-0")
        client.recipes.remove("A-1047")
        assert recipe not in client.recipes.list()


def test_records_as_columns(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        moves = [gripper.move(50 + step, 400) for step in range(3)]
        records = client.records.grips(3, kind="move")
        assert [record.id for record in records] == [move.id for move in reversed(moves)]
        table = columns(records)
        assert table["requested_width_mm"] == [52, 51, 50] and len(table["started_at"]) == 3
        assert columns(records, numpy=True)["width_mm"].mean() == pytest.approx(51, abs=0.2)
        assert columns(records, numpy=True)["contact_width_mm"].dtype.kind in "fO"
        curve = client.records.curve(moves[0].id)
        assert len(curve.t_ms) == len(curve.width_mm) == client.records.grip(moves[0].id).samples
        assert columns([]) == {}
        paged = client.records.grips(None, kind="all", after=0)
        assert [record.seq for record in paged] == sorted(record.seq for record in paged)


def test_record_of_a_grip_is_awaited(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client, client["left"].control() as gripper:
        gripper.release(60, 400)
        grip = gripper.grip(20, 400, part_id="A-7")
        with pytest.raises(Refused, match="not_found"):
            client.records.curve(grip.id)
        assert client.records.curve(grip.id, timeout_s=5).t_ms
        assert client.records.grip(grip.id, timeout_s=5).part_id == "A-7"
        gripper.release(60, 400)


def test_missing_package_of_an_extra_is_named() -> None:
    with pytest.raises(ImportError, match=r"openpi_client.*pip install 'wsg-gateway\[openpi\] @ http://GATEWAY:8080/python/wsg_"):
        importlib.import_module("wsg_gateway.openpi")


def test_unknown_outcome_says_so() -> None:
    motion = Motion.build({"kind": "grip", "gripper": "left", "outcome": "UNKNOWN"})
    with pytest.raises(UnexpectedOutcome, match="UNKNOWN: whether it was carried out is not known"):
        motion.expect()


def test_times_have_any_number_of_digits() -> None:
    for fraction, microsecond in [("", 0), (".41", 410_000), (".559", 559_000), (".123456", 123_456), (".1234567", 123_456)]:
        assert parse_time(f"2026-11-30T17:10:34{fraction}Z").microsecond == microsecond


def test_clock_offset(connect: Connect, gateway: Gateway) -> None:
    with connect(gateway.url) as client:
        offset = client.clock_offset()
        assert abs(offset.offset_s) <= offset.bound_s < 0.05


def test_wrong_use_says_what_to_do(connect: Connect, gateway: Gateway) -> None:
    with pytest.raises(ValueError, match="write http://HOST:PORT"):
        connect("127.0.0.1:8080")
    with pytest.raises(ValueError, match="write https://"):
        connect(gateway.url, tls="ca.pem")
    with pytest.raises(Unreachable, match="no connection to http://127.0.0.1:1 within 0.2 s"):
        connect("http://127.0.0.1:1", timeout_s=0.2)
    with connect(gateway.url) as client:
        with pytest.raises(KeyError, match="no gripper 'lef': this gateway has left, right"):
            client["lef"]
        with pytest.raises(AttributeError, match="has no 'grip': take control first, with left.control"):
            client["left"].grip(20)
        with pytest.raises(ValueError, match="home is a motion"):
            client.request("home", gripper="left")
        with pytest.raises(ValueError, match="keeps at least 1 item"):
            client.events(size=0)
        with pytest.raises(ControlLost, match="not taken yet"):
            client["left"].control().move(50)
    with pytest.raises(RuntimeError, match="closed"):
        client.clock_offset()


def test_program_shows_and_exports(gateway: Gateway) -> None:
    gateway.post("/grippers/left/release", width_mm=60, speed_mm_s=400)
    gateway.post("/grippers/left/grip", width_mm=20, speed_mm_s=400, part_id="=1+1")
    gateway.post("/grippers/left/release", width_mm=60, speed_mm_s=400)
    time.sleep(1.2)

    def output(*flags: str) -> list[str]:
        command = [sys.executable, "-m", "wsg_gateway", gateway.url, *flags]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()

    shown = output("--once")
    assert len(shown) == 2 and shown[0].startswith("left") and "60.00 mm" in shown[0]
    rows = output("--export", "csv", "--part-id", "=1+1")
    assert len(rows) == 2 and "'=1+1" in rows[1]
    assert json.loads(output("--export", "jsonl", "--part-id", "=1+1")[0])["outcome"] == "PART_HELD"
