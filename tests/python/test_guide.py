"""The programs of the guide and of the README files run as they are printed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from gateways import Gateway

ROOT = Path(__file__).resolve().parents[2]
PRINTED = "http://127.0.0.1:8080"


EXTRA = re.compile(r"from wsg_gateway( import mcap|\.\w+ import)")


def programs(page: str, extras: bool = False) -> list[str]:
    """The programs of a page that use the package, with an extra or without one."""
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    return [block for block in blocks if "wsg_gateway" in block and bool(EXTRA.search(block)) == extras]


PROGRAMS = [
    pytest.param(program, id=f"{page}-{number}")
    for page in ("deploy/guide/python.md", "README.md", "deploy/python/README.md")
    for number, program in enumerate(programs(page))
]


def output(gateway: Gateway, program: str, directory: Path) -> str:
    """Runs a program, and returns what it prints. Presses Enter once if it prompts."""
    assert PRINTED in program
    command = [sys.executable, "-c", program.replace(PRINTED, gateway.url)]
    done = subprocess.run(command, capture_output=True, input="\n", text=True, timeout=90, check=False, cwd=directory)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout


@pytest.mark.parametrize("program", PROGRAMS)
def test_program_runs(gateway: Gateway, program: str, tmp_path: Path) -> None:
    if "acknowledge(" in program:
        gateway.post("/fast-stop", reason="a test")
    shown = output(gateway, program, tmp_path)
    assert shown
    if "grip(" in program:
        assert "PART_HELD" in shown or "samples" in shown


def test_twenty_grips_are_in_the_guide() -> None:
    program = (ROOT / "tests/python/twenty_grips.py").read_text()
    assert program in programs("deploy/guide/python.md")
