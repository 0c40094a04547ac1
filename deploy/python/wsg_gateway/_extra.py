"""The packages of extras."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from . import __version__


@contextlib.contextmanager
def needed_by(extra: str) -> Iterator[None]:
    """Says how to install the packages of an extra if one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        wheel = f"http://GATEWAY:8080/python/wsg_gateway-{__version__}-py3-none-any.whl"
        raise ModuleNotFoundError(f"{error}: pip install 'wsg-gateway[{extra}] @ {wheel}'", name=error.name) from error
