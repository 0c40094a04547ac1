"""The parts that all tests share. Each test runs with the synchronous and with the asyncio API."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import bridge
import pytest
import wsg_gateway
from gateways import Gateway, running

Connect = Callable[..., Any]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Names a failed test as `tests/run` expects it."""
    if report.failed:
        print(f"\ntest {report.nodeid} ... FAILED")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the numbers for `tests/run`."""
    passed, failed, skipped = (len(terminalreporter.stats.get(kind, ())) for kind in ("passed", "failed", "skipped"))
    failed += len(terminalreporter.stats.get("error", ()))
    print(f"\ntest result: the Python package. {passed} passed; {failed} failed; {skipped} ignored")


@pytest.fixture(params=["sync", "aio"])
def connect(request: pytest.FixtureRequest) -> Connect:
    """The function `connect` of one of both APIs."""
    return wsg_gateway.connect if request.param == "sync" else bridge.connect


@pytest.fixture(scope="session")
def shared() -> Iterator[Gateway]:
    """A gateway with two simulated grippers: `left` has a part of 20 mm, `right` has none."""
    gateway = Gateway()
    with running(gateway):
        yield gateway


@pytest.fixture
def gateway(shared: Gateway) -> Gateway:
    """The gateway, whose grippers are homed, and free of FAST STOPs."""
    for gripper in ("left", "right"):
        if shared.state(gripper)["fast_stop"]:
            shared.acknowledge(gripper)
        if not shared.state(gripper)["referenced"]:
            shared.post(f"/grippers/{gripper}/home")
    return shared
