"""Shows the live state of a gateway in a terminal, or exports its grips."""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import Any

from . import Gateway, GatewayError, Gripper, GripRecord, connect

# A spreadsheet would run a text that begins with one of these as a formula.
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m wsg_gateway", description=__doc__)
    parser.add_argument("url", help="address of the gateway, such as http://127.0.0.1:8080")
    parser.add_argument("--token-file", type=Path, help="file with the token; otherwise the variable WSG_TOKEN has it, if any")
    parser.add_argument("--ca", type=Path, help="file with the certificate authority to trust")
    parser.add_argument("--once", action="store_true", help="show the state once")
    parser.add_argument("--export", choices=["csv", "jsonl"], help="write all grips as CSV or JSON lines instead")
    parser.add_argument("--gripper", help="export the grips of this gripper only")
    parser.add_argument("--part-id", help="export the grips of this part only")
    parser.add_argument("--since", help="export the grips since this time, such as 2026-11-21T09:00:00Z")
    return parser


def number(value: float | None, unit: str) -> str:
    return f"{'?':>7} {unit}" if value is None else f"{value:7.2f} {unit}"


def line(gripper: Gripper) -> str:
    """Shows a gripper in one line. A value that is not known is a question mark."""
    state = gripper.state
    if state is None:
        return f"{gripper.name:12} no state: the connection to the gateway is lost"
    age = gripper.age
    notes = [
        "FAST STOP " + (state.fast_stop_cause or "") if state.fast_stop else "FAST STOP ?" if state.fast_stop is None else "",
        f"controlled by {state.lease_holder}" if state.lease_holder else "",
        f"reserved for {state.reserved_for}" if state.reserved_for else "",
        state.link_cause or "",
    ]
    values = [number(gripper.width_mm, "mm"), number(gripper.force_n, "N"), number(gripper.speed_mm_s, "mm/s")]
    shown = [f"{state.gripper:12} {state.link:12} {state.state or '?':12}", *values]
    shown += ["age ? s" if age is None else f"age {age:.2f} s"]
    return "  ".join(shown + [note for note in notes if note])


def show(gateway: Gateway, is_once: bool) -> None:
    """Shows the grippers until Ctrl-C."""
    is_terminal = sys.stdout.isatty() and not is_once
    while True:
        lines = [line(gripper) for _, gripper in sorted(gateway.grippers.items())]
        clear = "\x1b[H\x1b[J" if is_terminal else ""
        print(clear + "\n".join(lines), flush=True)
        if is_once:
            return
        time.sleep(0.2 if is_terminal else 1)


def cell(value: Any) -> Any:
    """Makes a value safe for a spreadsheet, as the gateway's own CSV does."""
    if isinstance(value, datetime):
        return value.isoformat()
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def pages(gateway: Gateway, filters: dict[str, Any]) -> Iterator[GripRecord]:
    """Reads all records, page by page."""
    after = 0
    while page := gateway.records.grips(1000, after=after, **filters):
        yield from page
        after = page[-1].seq


def export(records: Iterable[GripRecord], form: str) -> None:
    """Writes the records to standard output."""
    names = [field.name for field in fields(GripRecord)]
    writer = csv.writer(sys.stdout, lineterminator="\n")
    if form == "csv":
        writer.writerow(names)
    for record in records:
        row = record.as_dict()
        if form == "csv":
            writer.writerow([cell(row[name]) for name in names])
        else:
            print(json.dumps(row, default=datetime.isoformat))


def main() -> None:
    options = arguments().parse_args()
    token = options.token_file.read_text().strip() if options.token_file else os.environ.get("WSG_TOKEN")
    try:
        with connect(options.url, token=token, tls=options.ca) as gateway:
            if options.export:
                filters = {"gripper": options.gripper, "part_id": options.part_id, "since": options.since}
                export(pages(gateway, filters), options.export)
            else:
                show(gateway, options.once)
    except (GatewayError, ValueError, OSError) as error:
        sys.exit(f"{options.url}: {error}")
    except KeyboardInterrupt:
        pass


if __name__ == "__main__":
    main()
