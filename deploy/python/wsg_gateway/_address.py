"""Address of a gateway, and the way in which a client proves its identity."""

from __future__ import annotations

import http.client
import json
import os
import ssl
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import SplitResult, urlencode, urlsplit

from ._errors import ConnectionLost, Refused, Unreachable


@dataclass(frozen=True)
class Address:
    """The address of a gateway, with the credential and the trusted certificates."""

    url: str
    token: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        """Refuses an address that cannot work."""
        if self.parts.scheme not in ("http", "https") or not self.parts.hostname:
            raise ValueError(f"{self.url!r} is not the address of a gateway: write http://HOST:PORT or https://HOST:PORT")
        if self.parts.scheme == "http" and self.tls is not None:
            raise ValueError(f"{self.url!r} has no TLS, but tls is given: write https://")

    @property
    def parts(self) -> SplitResult:
        """The parts of the URL."""
        return urlsplit(self.url.rstrip("/"))

    @property
    def websocket(self) -> str:
        """URL of the WebSocket."""
        return f"{self.parts._replace(scheme=self.parts.scheme.replace('http', 'ws')).geturl()}/api/v1/ws"

    @property
    def headers(self) -> dict[str, str]:
        """The credential as a header."""
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}

    def context(self) -> ssl.SSLContext | None:
        """The certificates to trust; `None` without TLS."""
        if self.parts.scheme == "http":
            return None
        if isinstance(self.tls, ssl.SSLContext):
            return self.tls
        return ssl.create_default_context(cafile=self.tls)

    def request(self, method: str, path: str, query: dict[str, Any], context: ssl.SSLContext | None, timeout_s: float) -> Any:
        """Sends one HTTP request on a connection of its own, and returns the JSON of the response. Blocks."""
        host, port = self.parts.hostname or "", self.parts.port
        connection: http.client.HTTPConnection
        if context is None:
            connection = http.client.HTTPConnection(host, port, timeout=timeout_s)
        else:
            connection = http.client.HTTPSConnection(host, port, timeout=timeout_s, context=context)
        sent = urlencode({key: value for key, value in query.items() if value is not None})
        target = f"{self.parts.path}{path}" + (f"?{sent}" if method == "GET" and sent else "")
        body = None if method == "GET" else json.dumps(query)
        try:
            connection.request(method, target, body, {**self.headers, "Connection": "close"})
            response = connection.getresponse()
            text = response.read()
        except (OSError, http.client.HTTPException) as error:
            raise ConnectionLost(f"no response from {self.url}: {error or type(error).__name__}") from error
        finally:
            connection.close()
        if response.status >= 400:
            raise refusal(text, response.status)
        return json.loads(text)


def refusal(body: bytes, status: int) -> Refused | Unreachable:
    """The problem in the body of a response; a response of something else, such as a proxy, has none."""
    try:
        problem = json.loads(body)
        if isinstance(problem, dict) and "code" in problem:
            return Refused(problem)
    except ValueError:
        pass
    return Unreachable(f"HTTP status {status} without a problem of the gateway: is there a proxy before it?")
