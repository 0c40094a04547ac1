#!/usr/bin/env python3
"""Runs every query of the Grafana dashboard and of the alerts against a Prometheus that scrapes a gateway.

usage: monitoring.py DIRECTORY http://127.0.0.1:PORT

DIRECTORY has the programs prometheus and promtool. The gateway serves two simulated grippers, `left` and `right`.
Before the queries run, this script homes and grips, takes a lease and requests a FAST STOP, so that each panel has
something to show.
"""

import json
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request

DEPLOY = pathlib.Path(__file__).parent.parent / "deploy"
DASHBOARD = DEPLOY / "grafana" / "wsg-gateway.json"

# Values of Grafana's variables.
VARIABLES = {"$gateway": ".*", "$gripper": ".*", "$__rate_interval": "10s", "$__range": "1m"}

# Queries that may return nothing.
MAY_BE_EMPTY = {'ALERTS{alertstate="firing"}'}

TIMEOUT_S = 30


def request(url, body=None, **headers):
    """Returns the JSON response to a GET, or to a POST of `body`."""
    data = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=TIMEOUT_S) as response:
        return json.load(response)


def work(base):
    """Makes each metric of a gripper change."""
    for gripper in ("left", "right"):
        path = f"{base}/api/v1/grippers/{gripper}"
        request(f"{path}/home", {})
        request(f"{path}/grip", {"width_mm": 20, "speed_mm_s": 100})
    path = f"{base}/api/v1/grippers/left"
    stopped = request(f"{path}/fast-stop", {"reason": "test"})
    request(f"{path}/acknowledge", {"fast_stop_id": stopped["fast_stop_id"]})
    request(f"{path}/lease", {"holder": "monitoring", "ttl_ms": 60_000})


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def configured(directory, target):
    """Writes a copy of the configuration that scrapes `target` every second, and returns its path."""
    text = (DEPLOY / "prometheus" / "prometheus.yml").read_text(encoding="utf-8")
    quick = text.replace("interval: 5s", "interval: 1s")
    assert quick != text, "the interval is replaced"
    (directory / "prometheus.yml").write_text(quick, encoding="utf-8")
    (directory / "targets.yml").write_text(f'- targets: ["{target}"]\n', encoding="utf-8")
    shutil.copy(DEPLOY / "prometheus" / "alerts.yml", directory)
    return directory / "prometheus.yml"


def queries():
    """The title and query of each panel."""
    for panel in json.loads(DASHBOARD.read_text(encoding="utf-8"))["panels"]:
        for target in panel.get("targets", []):
            yield panel["title"], target["expr"]


def query(base, expression):
    """Returns the series that match a query."""
    for variable, value in VARIABLES.items():
        expression = expression.replace(variable, value)
    answer = request(f"{base}/api/v1/query?{urllib.parse.urlencode({'query': expression})}")
    return answer["data"]["result"]


def until(what, found):
    """Waits until `found` returns something."""
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        try:
            if result := found():
                return result
        except OSError:
            pass  # Prometheus has not started yet.
        time.sleep(0.2)
    sys.exit(f"waited {TIMEOUT_S} s in vain: {what}")


def check(base, gateway):
    """Runs all queries and rules, and returns the numbers of passed and failed ones."""
    until("the gateway is scraped", lambda: query(base, "up == 1"))
    # An increase needs a sample before it.
    work(gateway)
    until("the FAST STOP is scraped", lambda: query(base, 'increase(wsg_fast_stops_total{cause="requested"}[1m]) > 0'))
    passed = failed = 0
    for title, expression in queries():
        series = query(base, expression)
        is_right = bool(series) or expression in MAY_BE_EMPTY
        print(f"{'ok' if is_right else 'FAILED':6} {title}: {len(series)} series")
        passed, failed = passed + is_right, failed + (not is_right)
    rules = [rule for group in request(f"{base}/api/v1/rules")["data"]["groups"] for rule in group["rules"]]
    for rule in rules:
        is_right = rule["health"] == "ok"
        print(f"{'ok' if is_right else 'FAILED':6} alert {rule['name']} {rule.get('lastError', '')}")
        passed, failed = passed + is_right, failed + (not is_right)
    return passed, failed


def main():
    programs, gateway = pathlib.Path(sys.argv[1]), sys.argv[2]
    with tempfile.TemporaryDirectory() as directory:
        directory = pathlib.Path(directory)
        config = configured(directory, gateway.removeprefix("http://"))
        subprocess.run([programs / "promtool", "check", "config", config], check=True)
        port = free_port()
        with open(directory / "log", "w", encoding="utf-8") as log:
            prometheus = subprocess.Popen(
                [programs / "prometheus", f"--config.file={config}", f"--storage.tsdb.path={directory / 'data'}",
                 f"--web.listen-address=127.0.0.1:{port}"],
                stdout=log, stderr=log,
            )
        try:
            passed, failed = check(f"http://127.0.0.1:{port}", gateway)
        finally:
            prometheus.terminate()
            prometheus.wait(TIMEOUT_S)
    print(f"test result: monitoring. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
