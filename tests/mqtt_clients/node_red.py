"""The guide's flow in Node-RED, while Node-RED, broker and gateway are killed, and others lock the database: node_red.py
DIRECTORY NUMBER.

DIRECTORY contains the packages of Node-RED. Afterwards the table equals the journal.
"""

from __future__ import annotations

import contextlib
import json
import random
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

from rig import DEPLOY, SIMULATED, Broker, Gateway, Load, broker_section, compare, free_port, stored, temporary_directory, until

FLOW = DEPLOY / "mqtt/node-red.json"


class NodeRed:
    """Node-RED with the flow, which can be killed and started again."""

    def __init__(self, packages: Path, directory: Path, broker: Broker, gateway: Gateway) -> None:
        self._program = packages / "node_modules/node-red/red.js"
        self._directory = directory / "node-red"
        self._directory.mkdir()
        self.database = directory / "records.db"
        nodes = json.loads(FLOW.read_text(encoding="utf-8"))
        for node in nodes:
            if node["id"] == "wsg-records":
                node["initialize"] = node["initialize"].replace("mqtt://localhost:1883", broker.url)
            if node["id"] == "wsg-database":
                node["db"] = str(self.database)
        (self._directory / "flows.json").write_text(json.dumps(nodes), encoding="utf-8")
        settings = {"flowFile": "flows.json", "uiPort": free_port(), "uiHost": "127.0.0.1", "httpAdminRoot": False,
                    "telemetry": {"enabled": False}, "logging": {"console": {"level": "info"}}}
        # Node-RED itself would install this package from the internet.
        (self._directory / "package.json").write_text('{"dependencies": {"mqtt": "*"}}', encoding="utf-8")
        (self._directory / "node_modules").mkdir()
        (self._directory / "node_modules/mqtt").symlink_to(packages / "node_modules/mqtt")
        (self._directory / "settings.js").write_text(f"module.exports = {json.dumps(settings)}", encoding="utf-8")
        self.start()

    def start(self) -> None:
        with open(self._directory / "log", "a", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                ["node", str(self._program), "--userDir", str(self._directory)], stdout=log, stderr=log
            )

    def log(self) -> str:
        return (self._directory / "log").read_text(encoding="utf-8")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


def lock(database: Path) -> None:
    """Keeps others from writing, for longer than the flow waits."""
    with contextlib.closing(sqlite3.connect(database, timeout=60)) as db:
        db.execute("BEGIN EXCLUSIVE")
        time.sleep(3)
        db.rollback()


def main() -> None:
    packages, kills = Path(sys.argv[1]), int(sys.argv[2])
    with temporary_directory() as directory, contextlib.ExitStack() as ending:
        broker = Broker(directory)
        ending.callback(broker.kill)
        gateway = Gateway(directory, [SIMULATED] * 4, broker_section(broker.url))
        ending.callback(gateway.kill)
        node_red = NodeRed(packages, directory, broker, gateway)
        ending.callback(node_red.kill)
        load = Load(gateway, 0.05)
        ending.callback(load.end)
        try:
            until("the first records", lambda: all(stored(node_red.database, name) for name in ("events", "grips")), 300)
            broker.save()
            begin = time.monotonic()
            for kill in range(kills):
                time.sleep(random.uniform(0.3, 2))
                each = (broker, node_red, gateway, node_red)[kill % 4]
                if each is node_red:
                    # It takes seconds to start.
                    time.sleep(4)
                    lock(node_red.database)
                each.kill()
                time.sleep(random.uniform(0, 0.5))
                each.start()
            time.sleep(2)
            lock(node_red.database)
            load.end()
            print(f"{kills} kills in turn of Node-RED, broker and gateway in {time.monotonic() - begin:.0f} s")
            print("the table of Node-RED equals the journal:", compare(gateway, node_red.database))
            gateway.terminate()
        except BaseException:
            print(node_red.log()[-5000:], file=sys.stderr)
            raise


main()
