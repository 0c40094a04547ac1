"""FAST STOPs and motions beside a broker that misbehaves: faults.py SECONDS [CASE…].

Each case has two gateways at the same time, of which one has no MQTT. Both get the same motions and, in turns, FAST STOPs
over HTTP. Whatever the broker does, times and memory are those of the gateway without MQTT, and the cause is in log, alarm
and metrics.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import socket
import statistics
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Sequence

from rig import SIMULATED, Broker, Gateway, Load, broker_section, temporary_directory, until

LINES = "commands = true\nfast_stop = true\nstate_interval_ms = 20\ntelemetry_interval_ms = 20"
STOPPED = "g0"
# An alarm comes after a minute, and the slowest failure is noticed after 30 s.
ALARM_WITHIN_S = 150
# More than noise, and less than any time limit of a connection to a broker.
MAX_RATIO = 1.5
MAX_MORE_MS = 5
MAX_MORE_MB = 30


class SlowPath:
    """Passes bytes between a gateway and a broker: so many a second in each direction, or each of them so much later."""

    def __init__(self, broker_port: int, bytes_a_second: float = 0, delay_s: float = 0) -> None:
        self._broker_port = broker_port
        self.bytes_a_second = bytes_a_second
        self.delay_s = delay_s
        self._server = socket.create_server(("127.0.0.1", 0))
        # Small buffers, so that the path itself holds few bytes.
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.url = f"mqtt://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            near, _ = self._server.accept()
            far = socket.create_connection(("127.0.0.1", self._broker_port))
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        waiting: list[tuple[float, bytes]] = []
        arrived = threading.Condition()

        def write() -> None:
            with contextlib.suppress(OSError):
                while True:
                    with arrived:
                        arrived.wait_for(lambda: waiting)
                        due, data = waiting.pop(0)
                    time.sleep(max(0.0, due - time.monotonic()))
                    if not data:
                        return other.shutdown(socket.SHUT_RDWR)
                    other.sendall(data)

        threading.Thread(target=write, daemon=True).start()
        data = b"begin"
        while data:
            try:
                data = one.recv(int(self.bytes_a_second / 10) or 65536)
            except OSError:
                data = b""
            with arrived:
                waiting.append((time.monotonic() + self.delay_s, data))
                arrived.notify()
            if self.bytes_a_second:
                time.sleep(len(data) / self.bytes_a_second)


class SilentBroker:
    """Accepts connections, and reads and sends nothing."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"mqtt://127.0.0.1:{self._server.getsockname()[1]}"
        self._held: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            self._held.append(self._server.accept()[0])


@dataclass
class Case:
    """Section of the configuration, and what the gateway says about it."""

    section: str
    # Text of the cause in the alarm; `None` if nothing fails.
    cause: str | None = None
    # Begins the fault, once the gateway is connected; `None` if it never is.
    begin: Callable[[], object] | None = None
    # Ends the fault, whereupon all records arrive; `None` if they do not.
    end: Callable[[], object] | None = None
    # Text of the cause in the log, if the first failure is another one than those that follow.
    logged: str | None = None


def broker(directory: Path, ending: contextlib.ExitStack, lines: str = "") -> Broker:
    started = Broker(directory, lines)
    ending.callback(started.kill)
    return started


def nothing() -> None:
    pass


def working(directory: Path, ending: contextlib.ExitStack) -> Case:
    return Case(broker_section(broker(directory, ending).url, LINES), begin=nothing, end=nothing)


def frozen(directory: Path, ending: contextlib.ExitStack) -> Case:
    started = broker(directory, ending)
    return Case(broker_section(started.url, LINES), "did not answer within 10 s", started.freeze, started.thaw)


def absent(directory: Path, ending: contextlib.ExitStack) -> Case:
    started = broker(directory, ending)
    return Case(broker_section(started.url, LINES), "cannot connect", started.kill, started.start, "closed the connection")


def silent(_directory: Path, _ending: contextlib.ExitStack) -> Case:
    return Case(broker_section(SilentBroker().url, LINES), "did not answer within 10 s")


def slow(directory: Path, ending: contextlib.ExitStack) -> Case:
    """1 kB/s, which is much less than the states need."""
    path = SlowPath(broker(directory, ending).port)

    def begin() -> None:
        path.bytes_a_second = 1000

    def end() -> None:
        path.bytes_a_second = 0

    return Case(broker_section(path.url, LINES), "the broker", begin, end)


def late(directory: Path, ending: contextlib.ExitStack) -> Case:
    """Each byte 2 s later, which is no failure. At most 32 records are under way, so the others wait meanwhile."""
    path = SlowPath(broker(directory, ending).port)

    def begin() -> None:
        path.delay_s = 2

    def end() -> None:
        path.delay_s = 0

    return Case(broker_section(path.url, LINES), begin=begin, end=end)


def certificate(directory: Path, ending: contextlib.ExitStack) -> Case:
    """The certificate of the broker comes from another authority than the one in the configuration."""
    for name in ("broker", "other"):
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                   "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-addext", "basicConstraints=CA:FALSE",
                   "-keyout", str(directory / f"{name}.key"), "-out", str(directory / f"{name}.pem")]
        subprocess.run(command, check=True, capture_output=True)
    started = broker(directory, ending, f"certfile {directory}/broker.pem\nkeyfile {directory}/broker.key")
    url = started.url.replace("mqtt://127.0.0.1", "mqtts://localhost")
    return Case(broker_section(url, f'{LINES}\nca_file = "{directory}/other.pem"'), "TLS failed")


def refusing(directory: Path, ending: contextlib.ExitStack, topics: Sequence[str] = ()) -> Case:
    """Clients may subscribe, but publish to these topics only."""
    rules = directory / "acl"
    rules.write_text("topic read #\n" + "".join(f"topic write wsg/cell/{topic}\n" for topic in topics), encoding="utf-8")
    rules.chmod(0o600)
    started = broker(directory, ending, f"acl_file {rules}")
    return Case(broker_section(started.url, LINES), "the broker refused a message")


def refusing_records(directory: Path, ending: contextlib.ExitStack) -> Case:
    return refusing(directory, ending, ("availability", "description", "alarms", "+/state", "+/telemetry"))


CASES: dict[str, Callable[[Path, contextlib.ExitStack], Case]] = {
    "working": working,
    "frozen": frozen,
    "absent": absent,
    "silent": silent,
    "slow": slow,
    "late": late,
    "certificate": certificate,
    "refusing": refusing,
    "refusing-records": refusing_records,
}


class Stops:
    """FAST STOPs on one connection, each acknowledged."""

    def __init__(self, gateway: Gateway) -> None:
        self.took_ms: list[float] = []
        # On a busy machine, the simulated gripper can confirm too late.
        self.unconfirmed = 0
        self._connection = http.client.HTTPConnection("127.0.0.1", gateway.port)

    def _post(self, path: str, body: object) -> tuple[int, dict]:
        self._connection.request("POST", f"/api/v1/grippers/{STOPPED}/{path}", json.dumps(body))
        answer = self._connection.getresponse()
        return answer.status, json.loads(answer.read())

    def one(self) -> None:
        begin = time.perf_counter()
        _, stop = self._post("fast-stop", {})
        self.took_ms.append((time.perf_counter() - begin) * 1000)
        self.unconfirmed += not stop["fast_stop_confirmed"]
        until("the acknowledgement", lambda: self._post("acknowledge", {"fast_stop_id": stop["fast_stop_id"]})[0] == 200)


def shown(took_ms: list[float]) -> str:
    quantiles = statistics.quantiles(took_ms, n=100, method="inclusive")
    return f"p50 {quantiles[49]:.1f}, p99 {quantiles[98]:.1f}, max {max(took_ms):.1f} ms of {len(took_ms)}"


def compared(what: str, took_ms: list[float], without_ms: list[float]) -> list[str]:
    """Prints both, and returns what is too slow."""
    print(f"  {what}: {shown(took_ms)}; without MQTT {shown(without_ms)}", flush=True)
    one, other = statistics.median(took_ms), statistics.median(without_ms)
    return [f"{what}: {one:.1f} ms, without MQTT {other:.1f} ms"] if one > MAX_RATIO * other + MAX_MORE_MS else []


def alarm(gateway: Gateway) -> str | None:
    for alarm in gateway.get("/api/v1/alarms")["alarms"]:
        if alarm["alarm"] == "mqtt_failing" and alarm.get("ended_at") is None:
            return alarm["cause"]
    return None


def told(gateway: Gateway, cause: str, logged: str) -> list[str]:
    """Checks alarm, metrics and log, and returns what is missing."""
    missing = []
    try:
        text = until("the alarm", lambda: alarm(gateway), ALARM_WITHIN_S)
        print(f"  alarm: {text}")
        if cause not in text:
            missing.append(f"cause of the alarm: {text}")
    except AssertionError as error:
        missing.append(str(error))
    failures = gateway.metric("wsg_mqtt_failures_total")
    warnings = [line for line in gateway.log().splitlines() if "MQTT connection failed; retrying" in line]
    print(f"  metrics: {failures:.0f} failures, {gateway.metric('wsg_mqtt_waiting_events'):.0f} events wait; {len(warnings)} warnings")
    for line in dict.fromkeys(re.sub(r"^\S+\s+|retry_in_ms=\d+", "", line) for line in warnings):
        print(f"  log: {line}")
    if failures == 0:
        missing.append("failures in the metrics")
    if not any(logged in line for line in warnings):
        missing.append("the cause in the log")
    return missing


def run(name: str, seconds: float, directory: Path) -> list[str]:
    """Runs a case, and returns what is wrong."""
    directory.mkdir()
    print(f"{name}:", flush=True)
    with contextlib.ExitStack() as ending:
        case = CASES[name](directory, ending)
        gateways = []
        for place, section in (("gateway", case.section), ("without", "")):
            gateways.append(Gateway(directory / place, [SIMULATED] * 3, section))
            ending.callback(gateways[-1].kill)
        gateway, without = gateways
        for each in gateways:
            state = f"/api/v1/grippers/{STOPPED}/state"
            until("the link", lambda: each.get(state)["link"] == "connected")
        if case.begin:
            until("all connections", lambda: gateway.metric("wsg_mqtt_connected") == 3)
            case.begin()
        loads = []
        for each in gateways:
            # The gripper that is stopped does not grip.
            loads.append(Load(each, names=each.names[1:]))
            ending.callback(loads[-1].end)
        stops = [Stops(each) for each in gateways]
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for each in stops:
                each.one()
            time.sleep(0.02)
        print(f"  unconfirmed FAST STOPs: {stops[0].unconfirmed}, without MQTT {stops[1].unconfirmed}")
        wrong = compared("FAST STOP", stops[0].took_ms, stops[1].took_ms)
        wrong += compared("grip", loads[0].took_ms, loads[1].took_ms)
        if case.cause is not None:
            wrong += told(gateway, case.cause, case.logged or case.cause)
        elif failures := gateway.metric("wsg_mqtt_failures_total"):
            wrong.append(f"{failures:.0f} failures")
        print(f"  memory: at most {gateway.peak_mb():.0f} MB, without MQTT {without.peak_mb():.0f} MB", flush=True)
        if gateway.peak_mb() > without.peak_mb() + MAX_MORE_MB:
            wrong.append("memory")
        for load in loads:
            load.end()
        if case.end:
            case.end()
            begin = time.monotonic()
            until("nothing waiting", lambda: gateway.metric("wsg_mqtt_waiting_events") == 0, 300)
            print(f"  no event waits {time.monotonic() - begin:.0f} s later")
        for each in gateways:
            each.terminate()
        return wrong


def main() -> None:
    seconds = float(sys.argv[1])
    wrong: list[str] = []
    with temporary_directory() as directory:
        for name in sys.argv[2:] or CASES:
            wrong += [f"{name}: {each}" for each in run(name, seconds, directory / name)]
    assert not wrong, "\n".join(wrong)


main()
