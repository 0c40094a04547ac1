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


def programs(page: str) -> list[str]:
    """The programs of a page that use the package."""
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    return [block for block in blocks if "wsg_gateway" in block]


PROGRAMS = [
    pytest.param(program, id=f"{page}-{number}")
    for page in ("deploy/guide/python.md", "README.md", "deploy/python/README.md")
    for number, program in enumerate(programs(page))
]


@pytest.mark.parametrize("program", PROGRAMS)
def test_program_runs(gateway: Gateway, program: str) -> None:
    assert PRINTED in program
    done = subprocess.run(
        [sys.executable, "-c", program.replace(PRINTED, gateway.url)], capture_output=True, text=True, timeout=90, check=False
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert done.stdout
    if "grip(" in program:
        assert "PART_HELD" in done.stdout or "samples" in done.stdout


def test_twenty_grips_are_in_the_guide() -> None:
    program = (ROOT / "tests/python/twenty_grips.py").read_text()
    assert program in programs("deploy/guide/python.md")
