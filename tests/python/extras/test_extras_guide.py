"""The guide's programs with extras run as they are printed."""

from __future__ import annotations

from pathlib import Path

import pytest
from gateways import Gateway
from test_guide import output, programs


@pytest.mark.parametrize("program", programs("deploy/guide/python.md", extras=True))
def test_program_with_an_extra_runs(gateway: Gateway, program: str, tmp_path: Path) -> None:
    assert "PART_HELD" in output(gateway, program, tmp_path)
    assert "Recorder" not in program or list(tmp_path.glob("*.mcap"))
