"""The gateway serves the wheel of its own version, and pip installs it from there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import wsg_gateway
from gateways import Gateway

PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
ROOT = Path(__file__).resolve().parents[2]


def wheel() -> str:
    return f"wsg_gateway-{wsg_gateway.__version__}-py3-none-any.whl"


def test_pip_installs_the_wheel_of_the_gateway(gateway: Gateway, tmp_path: Path) -> None:
    url = f"{gateway.url}/python/{wheel()}"
    subprocess.run([*PIP, "install", "--no-index", "--no-deps", "--target", str(tmp_path), url], check=True)
    program = "import wsg_gateway; print(wsg_gateway.__version__, wsg_gateway.__file__)"
    command = [sys.executable, "-c", program]
    shown = subprocess.run(command, env={"PYTHONPATH": str(tmp_path)}, check=True, capture_output=True, text=True).stdout
    assert shown.split() == [wsg_gateway.__version__, str(tmp_path / "wsg_gateway/__init__.py")]


def test_pip_finds_the_wheel_on_the_page(gateway: Gateway, tmp_path: Path) -> None:
    links = ["--no-index", "--find-links", f"{gateway.url}/python/"]
    subprocess.run([*PIP, "download", *links, "--no-deps", "--dest", str(tmp_path), "wsg-gateway"], check=True)
    assert [file.name for file in tmp_path.iterdir()] == [wheel()]


def test_documents_name_the_served_wheel() -> None:
    for page in ("README.md", "deploy/guide/python.md", "deploy/guide/ros2.md"):
        assert f"/python/{wheel()}" in (ROOT / page).read_text(), page
