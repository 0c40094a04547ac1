"""The package against a gateway with TLS, tokens and roles."""

from __future__ import annotations

import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from gateways import PROGRAM, Gateway, free_port, running, token, until
from wsg_gateway import Refused, Unreachable
from wsg_gateway._address import Address

Connect = Callable[..., Any]


class Guarded(Gateway):
    """A gateway with TLS and tokens."""

    def __init__(self, directory: Path) -> None:
        port = free_port()
        self.directory = directory / "guarded"
        self.configuration = self.directory / "wsg-gateway.toml"
        flags = ["--listen", f"127.0.0.1:{port}", "--host", "localhost", "--host", "127.0.0.1"]
        subprocess.run([PROGRAM, "init", *flags, str(self.directory)], check=True, capture_output=True)
        super().__init__("--config", str(self.configuration), scheme="https", port=port)
        self.ca = self.directory / "certificate.pem"
        self.tokens = {role: token(self.configuration, role, role) for role in ("stop", "observer", "operator")}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    made = Guarded(tmp_path_factory.mktemp("access"))
    with running(made):
        yield made


def test_operator_moves_with_a_file_or_a_context(connect: Connect, guarded: Guarded) -> None:
    for tls in (guarded.ca, str(guarded.ca), ssl.create_default_context(cafile=str(guarded.ca))):
        with connect(guarded.url, token=guarded.tokens["operator"], tls=tls) as client:
            with client["left"].control() as gripper:
                gripper.home(if_needed=True)
                assert gripper.move(60, 400).subject == "operator"
                assert client.records.grips(1, kind="move")


def test_observer_reads_and_triggers_fast_stops_only(connect: Connect, guarded: Guarded) -> None:
    operator = connect(guarded.url, token=guarded.tokens["operator"], tls=guarded.ca)
    with operator, connect(guarded.url, token=guarded.tokens["observer"], tls=guarded.ca) as client:
        assert client["left"].link == "connected"
        with pytest.raises(Refused, match="operator") as refused, client["left"].control():
            pass
        assert refused.value.code == "forbidden"
        stop = client.fast_stop()
        for gripper in operator.grippers.values():
            gripper.acknowledge(stop.id)


def test_client_that_may_only_stop(connect: Connect, guarded: Guarded) -> None:
    with pytest.raises(Refused, match="forbidden"):
        connect(guarded.url, token=guarded.tokens["stop"], tls=guarded.ca)
    operator = connect(guarded.url, token=guarded.tokens["operator"], tls=guarded.ca)
    with operator, connect(guarded.url, token=guarded.tokens["stop"], tls=guarded.ca, topics=()) as client:
        stop = client["left"].fast_stop("light curtain")
        assert stop.confirmed
        operator["left"].acknowledge(stop.id)
        with pytest.raises(ValueError, match="not subscribed"):
            client.events()


def test_wrong_credentials_and_certificates(connect: Connect, guarded: Guarded) -> None:
    for wrong in (None, "wsg" + "0" * 44):
        with pytest.raises(Refused) as refused:
            connect(guarded.url, token=wrong, tls=guarded.ca)
        assert refused.value.code == "unauthorized"
    with pytest.raises(Unreachable, match="certificate verify failed"):
        connect(guarded.url, token=guarded.tokens["operator"], timeout_s=1)
    with pytest.raises(FileNotFoundError):
        connect(guarded.url, tls="missing.pem")


def test_token_is_not_shown(guarded: Guarded) -> None:
    assert guarded.tokens["operator"] not in repr(Address(guarded.url, guarded.tokens["operator"]))


def test_other_server_is_named(connect: Connect) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        with pytest.raises(Unreachable, match=r"no connection to http://127.0.0.1:\d+ within 0.5 s"):
            connect(f"http://127.0.0.1:{server.getsockname()[1]}", timeout_s=0.5)


def test_revoked_token_loses_control(connect: Connect, guarded: Guarded) -> None:
    secret = token(guarded.configuration, "guest", "operator")
    with connect(guarded.url, token=secret, tls=guarded.ca) as client, client["left"].control() as gripper:
        command = [PROGRAM, "token", "revoke", "--config", str(guarded.configuration), "guest"]
        subprocess.run(command, check=True, capture_output=True)
        until(lambda: not gripper.held)
        until(lambda: isinstance(client_error(client), Refused))
        with pytest.raises(Refused, match="unauthorized"), client["left"].control(timeout_s=0.2):
            pass


def client_error(client: Any) -> Exception:
    error: Exception = client._core.main.error
    return error
