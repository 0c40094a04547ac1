"""Pages of the journal."""

from __future__ import annotations

import asyncio
import time
from typing import Any, cast
from urllib.parse import quote

from ._core import Core, event
from ._errors import Refused
from ._types import Curve, Event, GripRecord

PAGE = 1000
# Pause between two looks for a record.
LOOK_S = 0.1


class Records:
    """Reads the lists of the journal page by page."""

    def __init__(self, core: Core) -> None:
        """Reads over HTTP, because the WebSocket does not have these lists."""
        self._core = core

    async def grips(self, limit: int | None, after: int | None, filters: dict[str, Any]) -> list[GripRecord]:
        """Grip records, newest first, or those after a `seq`."""
        return [GripRecord.build(record) for record in await self._all("grips", limit, after, filters)]

    async def events(self, limit: int | None, after: int | None, filters: dict[str, Any]) -> list[Event]:
        """Events, newest first, or those after a `seq`."""
        return [cast("Event", event(record)) for record in await self._all("events", limit, after, filters)]

    async def grip(self, command_id: str, timeout_s: float) -> GripRecord:
        """One record."""
        return GripRecord.build(await self._written(f"/grips/{quote(command_id, safe='')}", timeout_s))

    async def curve(self, command_id: str, timeout_s: float) -> Curve:
        """The curve of a motion."""
        return Curve.build(await self._written(f"/grips/{quote(command_id, safe='')}/curve", timeout_s))

    async def _written(self, path: str, timeout_s: float) -> Any:
        """Reads something that may not be written yet."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return await self._core.get(path)
            except Refused as refused:
                if refused.code != "not_found" or time.monotonic() >= deadline:
                    raise
            await asyncio.sleep(LOOK_S)

    async def _all(self, name: str, limit: int | None, after: int | None, filters: dict[str, Any]) -> list[dict[str, Any]]:
        records: list[dict[str, Any]] = []
        cursor = None if after is None else str(after)
        order = None if after is None else "oldest"
        while limit is None or len(records) < limit:
            size = PAGE if limit is None else min(PAGE, limit - len(records))
            page = await self._core.get(f"/{name}", limit=size, cursor=cursor, order=order, **filters)
            records += page[name]
            cursor = page["next_cursor"]
            if not page["has_more"]:
                break
        return records
