"""The parts that all data classes of the API have in common."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from ._errors import UnexpectedOutcome

if TYPE_CHECKING:
    from typing_extensions import Self

FRACTION = re.compile(r"\.\d+")


def parse_time(text: str) -> datetime:
    """Reads a time of the API, which is in UTC."""
    # Python 3.10 reads fractions of three and of six digits only.
    return datetime.fromisoformat(FRACTION.sub(lambda found: found[0][:7].ljust(7, "0"), text).replace("Z", "+00:00"))


class Model:
    """A data class that is built from a JSON object. Members without a field are ignored; missing ones become `None`."""

    __slots__ = ()
    _times: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def build(cls, data: Mapping[str, Any]) -> Self:
        """Builds the object from JSON that the gateway has sent."""
        values: dict[str, Any] = {name: data.get(name) for name in cls.__dataclass_fields__ if name != "_times"}  # type: ignore[attr-defined]
        for name in cls._times:
            if (text := values[name]) is not None:
                values[name] = parse_time(text)
        return cls(**values)

    def as_dict(self) -> dict[str, Any]:
        """Returns the fields by their names."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


class Result(Model):
    """The end of a motion."""

    __slots__ = ()
    if TYPE_CHECKING:
        kind: Any
        gripper: Any
        outcome: Any
        detail: Any
        fast_stop_id: Any

    @property
    def ok(self) -> bool:
        """Whether the outcome is `SUCCESS` or `PART_HELD`. Any other outcome, also one that is not known, is not OK."""
        return self.outcome in ("SUCCESS", "PART_HELD")

    def expect(self, *outcomes: str) -> Self:
        """Returns this motion, or raises `UnexpectedOutcome`.

        Without arguments, expects `SUCCESS` or `PART_HELD`.
        """
        if self.outcome in outcomes or (not outcomes and self.ok):
            return self
        raise UnexpectedOutcome(self)


@dataclass(frozen=True, slots=True)
class OtherEvent(Model):
    """An event of a kind that this version of the package does not know."""

    kind: Literal["other"]
    gripper: str | None
    seq: int
    data: dict[str, Any]
    """The event as the gateway sent it."""


def columns(records: Iterable[Model], numpy: bool = False) -> dict[str, Any]:
    """Turns records into columns: a list for each field, or a numpy array if `numpy` is true and numpy is installed."""
    rows = [record.as_dict() for record in records]
    table: dict[str, Any] = {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}
    if numpy:
        import numpy as np  # noqa: PLC0415

        # A missing number becomes NaN rather than an object.
        table = {name: np.array(column_of_numbers(column)) for name, column in table.items()}
    return table


def column_of_numbers(column: list[Any]) -> list[Any]:
    """Replaces `None` by NaN in a column that has only numbers besides."""
    if any(value is None for value in column) and all(value is None or is_number(value) for value in column):
        return [float("nan") if value is None else float(value) for value in column]
    return column


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
