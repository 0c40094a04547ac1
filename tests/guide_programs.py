"""Runs the Python programs of a Markdown page, each in a scenario of its own.

A program is a Python block that begins with #!, and whose docstring ends with how to call it: name.py ARGUMENTS.
"""

import base64
import contextlib
import hashlib
import hmac
import json
import os
import re
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

WITHIN_S = 30


def programs(page):
    """The programs with their names."""
    for block in re.findall(r"^```python\n(#!.*?)^```", page, re.DOTALL | re.MULTILINE):
        yield re.search(r"\b\w+\.py\b", block)[0], block


def until(what, found):
    """Waits until `found` returns a true value, and returns it."""
    deadline = time.monotonic() + WITHIN_S
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, sqlite3.OperationalError):
            if value := found():
                return value
        time.sleep(0.1)
    raise AssertionError(f"{what}: not within {WITHIN_S} s")


def rows(file, query):
    """The rows that a program has stored."""
    with contextlib.closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as db:
        return db.execute(query).fetchall()


@contextlib.contextmanager
def running(*command, **variables):
    """A program that is ended afterwards."""
    env = {**os.environ, **variables}
    with subprocess.Popen([sys.executable, *command], env=env, stderr=subprocess.DEVNULL) as process:
        try:
            yield
            assert process.poll() is None, "the program has ended"
        finally:
            process.kill()


def request(address, body=None, headers=None):
    """The status and the text of a response."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, body, headers or {}), timeout=10) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, b""


def follow_gateway(program, base, directory):
    """The records of a motion, and all earlier ones, arrive in the database."""
    file = os.path.join(directory, "gateway.db")
    status, _ = request(f"{base}/api/v1/grippers/left/home?wait_ms=10000", b"{}")
    assert status == 200, status

    def listed():
        return json.loads(request(f"{base}/api/v1/grips?kind=all&limit=1000")[1])["grips"]

    until("the record of the motion", listed)
    with running(program, base, file):
        ids = {grip["id"] for grip in listed()}
        until("all grip records", lambda: ids <= {id for id, in rows(file, "SELECT id FROM grips")})
        done = "SELECT COUNT(*) FROM events WHERE kind = 'command' AND body LIKE '%\"done\"%'"
        until("the end of the motion", lambda: rows(file, done)[0][0])


def receive_events(program, _base, directory):
    """A genuine delivery is stored once. Any other is refused."""
    file, key = os.path.join(directory, "events.db"), os.urandom(24)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    secret = "whsec_" + base64.b64encode(key).decode()

    def deliver(name, body, signed=None, age_s=0):
        timestamp = str(int(time.time()) - age_s)
        text = f"{name}.{timestamp}.".encode() + (signed or body)
        tag = base64.b64encode(hmac.new(key, text, hashlib.sha256).digest()).decode()
        headers = {"webhook-id": name, "webhook-timestamp": timestamp, "webhook-signature": f"v1,{tag}"}
        return request(f"http://127.0.0.1:{port}/", body, headers)[0]

    with running(program, str(port), file, WSG_SECRET=secret):
        body = b'{"kind": "fast_stop"}'
        until("the receiver", lambda: deliver("one", body) == 204)
        assert [deliver("one", body), deliver("two", body)] == [204, 204]
        assert deliver("three", body, signed=b"{}") == 401, "a changed body"
        assert deliver("four", body, age_s=3600) == 401, "an old delivery"
        assert rows(file, "SELECT id, kind FROM deliveries ORDER BY id") == [("one", "fast_stop"), ("two", "fast_stop")]


SCENARIOS = {"follow_gateway.py": follow_gateway, "receive_events.py": receive_events}


def run(page, base):
    """Runs the programs of a page. Returns the numbers of passed and failed ones."""
    passed = failed = 0
    for name, text in programs(page):
        with tempfile.TemporaryDirectory() as directory:
            program = os.path.join(directory, name)
            with open(program, "w", encoding="utf-8") as file:
                file.write(text)
            try:
                SCENARIOS[name](program, base, directory)
                passed += 1
                print(f"ok     {name}")
            except (AssertionError, KeyError, OSError) as error:
                failed += 1
                print(f"FAILED {name}: {error!r}")
    return passed, failed
