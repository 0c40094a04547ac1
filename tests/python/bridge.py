"""Lets a synchronous test drive the asyncio API: each call runs in an event loop in another thread."""

from __future__ import annotations

import asyncio
import inspect
import threading
from typing import Any

import wsg_gateway.aio


class Bridge:
    """An object of `wsg_gateway.aio` that looks like its synchronous twin."""

    loop: asyncio.AbstractEventLoop | None = None

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    @classmethod
    def run(cls, function: Any, *arguments: Any, **named: Any) -> Any:
        """Calls a function in the loop, and awaits its result."""
        if cls.loop is None:
            cls.loop = asyncio.new_event_loop()
            threading.Thread(target=cls.loop.run_forever, daemon=True).start()

        async def invoke() -> Any:
            try:
                result = function(*arguments, **named)
                return await result if inspect.isawaitable(result) else result
            except StopAsyncIteration:
                return StopIteration

        result = asyncio.run_coroutine_threadsafe(invoke(), cls.loop).result()
        if result is StopIteration:
            raise StopIteration
        return cls.wrap(result)

    @classmethod
    def wrap(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return {key: cls.wrap(inner) for key, inner in value.items()}
        return cls(value) if type(value).__module__ == "wsg_gateway.aio" else value

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)
        if inspect.ismethod(value):
            return lambda *arguments, **named: self.run(value, *arguments, **named)
        return self.wrap(value)

    def __getitem__(self, name: str) -> Any:
        return self.wrap(self._inner[name])

    def __enter__(self) -> Any:
        return self.run(self._inner.__aenter__)

    def __exit__(self, *error: Any) -> None:
        self.run(self._inner.__aexit__, *error)

    def __iter__(self) -> Any:
        return self

    def __next__(self) -> Any:
        return self.run(self._inner.__anext__)


def connect(url: str, **options: Any) -> Any:
    """`wsg_gateway.aio.connect`, awaited."""
    return Bridge.run(lambda: wsg_gateway.aio.connect(url, **options))
