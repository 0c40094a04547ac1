"""Mosquitto, gateways with simulated grippers, load, and the subscriber of the guide, as processes of their own."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

DEPLOY = Path(__file__).parents[2] / "deploy"
GUIDE = DEPLOY / "guide/mqtt.md"
COMPOSED = DEPLOY / "compose/mosquitto.conf"
MOSQUITTO = os.environ["MOSQUITTO"]
GATEWAY = os.environ["WSG_GATEWAY_PROGRAM"]
WITHIN_S = 60
SIMULATED = "sim://wsg50?part_mm=20"


@contextlib.contextmanager
def temporary_directory() -> Iterator[Path]:
    """A directory in memory, if there is one: a busy disk can exceed the 500 ms after which motions are refused."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        yield Path(name)


def until(what: str, found: Callable[[], Any], within_s: float = WITHIN_S) -> Any:
    """Waits until `found` returns a true value, and returns it."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, http.client.HTTPException, sqlite3.OperationalError):
            if value := found():
                return value
        time.sleep(0.05)
    raise AssertionError(f"{what}: not within {within_s} s")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def guide_settings() -> str:
    """Mosquitto's settings in the guide."""
    return re.search(r"^```conf\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)[1]


def compose_settings() -> str:
    """Mosquitto's settings in docker-compose.yml, apart from what the test sets itself."""
    text = COMPOSED.read_text(encoding="utf-8")
    for line in ("listener 1883\n", "allow_anonymous true\n"):
        assert line in text
        text = text.replace(line, "")
    return text


class Broker:
    """Mosquitto with these settings, and with these lines before them. It can be killed and started again."""

    def __init__(self, directory: Path, lines: str = "", settings: str = "") -> None:
        self.port = free_port()
        self._store = directory / "mosquitto"
        self._store.mkdir()
        settings = settings or guide_settings()
        settings = re.sub("(?m)^persistence_location .*$", f"persistence_location {self._store}/", settings)
        self._file = directory / "mosquitto.conf"
        user = "user root\n" if os.geteuid() == 0 else ""
        self._file.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\n{lines}\n{user}{settings}", encoding="utf-8"
        )
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self._file)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until("Mosquitto", lambda: socket.create_connection(("127.0.0.1", self.port), 1).close() or True)

    def save(self) -> None:
        """Waits until the sessions that exist now are on disk."""
        now = time.time()
        until("a saved session", lambda: (self._store / "mosquitto.db").stat().st_mtime > now)

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def freeze(self) -> None:
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        self._process.send_signal(signal.SIGCONT)


class Simulators:
    """Simulated grippers in a process of their own, so that their processor time is not the gateway's."""

    def __init__(self, directory: Path, count: int) -> None:
        self._file = directory / "simulators.log"
        with open(self._file, "w", encoding="utf-8") as file:
            command = [GATEWAY, "sim", *["tcp://127.0.0.1:0"] * count, "--part-mm", "20"]
            self._process = subprocess.Popen(command, stdout=file, stderr=file)
        self.urls: list[str] = until("simulated grippers", lambda: self._addresses(count))

    def _addresses(self, count: int) -> list[str] | None:
        found = re.findall(r"tcp://\S+", self._file.read_text(encoding="utf-8"))
        return found if len(found) == count else None

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


def broker_section(url: str, lines: str = "") -> str:
    return f'[mqtt]\nbroker = "{url}"\n{lines}\n'


class Gateway:
    """A gateway with grippers at these URLs, and a journal that outlasts it. `mqtt` is the section of its configuration."""

    def __init__(self, directory: Path, urls: Sequence[str], mqtt: str) -> None:
        directory.mkdir(exist_ok=True)
        self._directory = directory
        self.port = free_port()
        self.names = [f"g{index}" for index in range(len(urls))]
        sections = "".join(f'[grippers.{name}]\nurl = "{url}"\n' for name, url in zip(self.names, urls))
        self._file = directory / "gateway.toml"
        self._file.write_text(
            f'name = "cell"\nlisten = "127.0.0.1:{self.port}"\njournal = "{directory}/journal.db"\n'
            f'[zenoh]\nmode = "off"\n{mqtt}{sections}',
            encoding="utf-8",
        )
        self.start()

    def start(self) -> None:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("WSG_GATEWAY")}
        with open(self._directory / "gateway.log", "a", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                [GATEWAY, "--config", str(self._file)], stdout=log, stderr=log, env=environment
            )
        until("the gateway", lambda: self.get("/healthz") is not None)

    def log(self) -> str:
        return (self._directory / "gateway.log").read_text(encoding="utf-8")

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def terminate(self) -> None:
        self._process.terminate()
        assert self._process.wait(timeout=30) == 0

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=10) as answer:
            text = answer.read().decode()
        return json.loads(text) if text.startswith(("{", "[")) else text

    def post(self, path: str, body: object) -> Any:
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.port}/api/v1{path}", json.dumps(body).encode(), {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=30) as answer:
            return json.loads(answer.read())

    def records(self, name: str) -> dict[int, dict]:
        """All records of the journal's list, by their numbers."""
        records: dict[int, dict] = {}
        cursor = ""
        kinds = "&kind=all" if name == "grips" else ""
        while True:
            page = self.get(f"/api/v1/{name}?order=oldest&limit=1000{kinds}{cursor}")
            records.update((record["seq"], record) for record in page[name])
            if not page["has_more"]:
                return records
            cursor = "&cursor=" + urllib.parse.quote(page["next_cursor"])

    def metric(self, name: str) -> float:
        lines = self.get("/metrics").splitlines()
        return sum(float(line.rsplit(" ", 1)[1]) for line in lines if re.match(rf"{name}(\{{|\s)", line))

    def processor_s(self) -> float:
        """User and system time of the process."""
        with open(f"/proc/{self.pid}/stat", encoding="ascii") as file:
            fields = file.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def peak_mb(self) -> float:
        """Largest resident memory of the process so far."""
        with open(f"/proc/{self.pid}/status", encoding="ascii") as file:
            return int(re.search(r"VmHWM:\s+(\d+) kB", file.read())[1]) * 1024 / 1e6


class Load:
    """Grips and releases on grippers, whatever happens to the gateway: with a pause after each motion, or so many grips a
    minute of all grippers together."""

    def __init__(self, gateway: Gateway, pause_s: float = 0, names: Sequence[str] = (), grips_a_minute: float = 0) -> None:
        self.took_ms: list[float] = []
        self._gateway = gateway
        self._pause_s = pause_s
        self._is_over = threading.Event()
        names = names or gateway.names
        self._period_s = 60 * len(names) / grips_a_minute if grips_a_minute else 0
        self._threads = [threading.Thread(target=self._run, args=(name,)) for name in names]
        for thread in self._threads:
            thread.start()

    @property
    def grips(self) -> int:
        return len(self.took_ms)

    def _run(self, name: str) -> None:
        while not self._is_over.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException, KeyError):
                path = f"/grippers/{name}"
                self._gateway.post(f"{path}/home?wait_ms=20000", {})
                due = time.monotonic()
                while not self._is_over.is_set():
                    begin = time.monotonic()
                    grip = self._gateway.post(f"{path}/grip?wait_ms=20000", {"width_mm": 20, "speed_mm_s": 200, "part_id": f"part-{name}"})
                    if grip["phase"] == "done":
                        self.took_ms.append((time.monotonic() - begin) * 1000)
                    self._is_over.wait(self._pause_s)
                    self._gateway.post(f"{path}/release?wait_ms=20000", {"width_mm": 23, "speed_mm_s": 200})
                    due += self._period_s
                    self._is_over.wait(max(self._pause_s, due - time.monotonic()))
            self._is_over.wait(0.1)

    def end(self) -> None:
        self._is_over.set()
        for thread in self._threads:
            thread.join()


@contextlib.contextmanager
def guide_subscriber(directory: Path, broker: Broker, prefix: str) -> Iterator[Path]:
    """The program of the guide, which stores records in the database that is returned."""
    guide = GUIDE.read_text(encoding="utf-8")
    program = directory / "store_records.py"
    text = re.search(r"^```python\n(#!.*?)^```", guide, re.DOTALL | re.MULTILINE)[1]
    program.write_text(text, encoding="utf-8")
    database = directory / "records.db"
    command = [sys.executable, str(program), "127.0.0.1", str(broker.port), prefix, str(database)]
    with subprocess.Popen(command) as process:
        try:
            yield database
            assert process.poll() is None, "the subscriber has ended"
        finally:
            process.kill()


def stored(database: Path, name: str) -> dict[int, dict]:
    """The records of a list that the subscriber has stored, by their numbers."""
    with contextlib.closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=60)) as db:
        rows = db.execute("SELECT seq, body FROM records WHERE list = ?", [name]).fetchall()
    return {seq: json.loads(body) for seq, body in rows}


def difference(table: dict[int, dict], journal: dict[int, dict]) -> str:
    """Says how the table differs from the journal from its first record on; empty if they are equal."""
    if not table:
        return "the table is empty"
    missing = [seq for seq in journal if seq >= min(table) and seq not in table]
    if missing:
        return f"{len(missing)} of {len(journal)} records are missing, from {missing[0]} to {missing[-1]}"
    stored = {seq: {key: value for key, value in record.items() if key != "journal_id"} for seq, record in table.items()}
    changed = [seq for seq, record in stored.items() if record != journal.get(seq)]
    return f"{len(changed)} records differ, from {changed[0]}" if changed else ""


def compare(gateway: Gateway, database: Path, within_s: float = 300) -> dict[str, int]:
    """Waits until the table equals the journal from its first record on, and returns the numbers of records."""
    counts = {}
    for name in ("events", "grips"):
        deadline = time.monotonic() + within_s
        while why := difference(stored(database, name), gateway.records(name)):
            assert time.monotonic() < deadline, f"{name}: {why}"
            time.sleep(0.5)
        counts[name] = len(stored(database, name))
    return counts
