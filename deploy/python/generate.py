#!/usr/bin/env python3
"""Generates the types of the package from the API's document, the synchronous module from the asyncio one, and the wheel.

usage: generate.py [--check]

pip builds the wheel with hatchling, and downloads hatchling if this Python does not have it.

With --check, writes nothing, and fails if a generated file is out of date.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
import textwrap
import zipfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PACKAGE = HERE / "wsg_gateway"
SCHEMAS: dict[str, Any] = json.loads((HERE.parents[1] / "openapi/openapi.json").read_text())["components"]["schemas"]

# Schemas that become data classes, with their names in Python.
NAMES = {
    "GripperState": "State",
    "Command": "Motion",
    "StoredGripRecord": "GripRecord",
    "Curve": "Curve",
    "RecipeVersion": "Recipe",
    "ProposedLimits": "ProposedLimits",
    "Lease": "Lease",
    "Info": "Info",
    "ServoReport": "ServoReport",
}
EVENTS = {ref.rpartition("/")[2] for ref in SCHEMAS["StoredEvent"]["discriminator"]["mapping"].values()}
NAMES |= {name: name for name in sorted(EVENTS)}
# Enumerations that requests use, apart from those that the data classes use.
ENUMERATIONS = {"Code", "Outcome", "EventKind", "OnLossMoving", "OnLossHolding", "OnBlock", "Direction", "GripKinds", "Order"}
# Secrets stay inside the package.
LEFT_OUT = {"Lease": {"token"}}
BASES = {"Motion": "Result"}
SCALARS = {"string": "str", "integer": "int", "number": "float", "boolean": "bool"}


def literal(values: list[str]) -> str:
    return f"Literal[{', '.join(json.dumps(value) for value in values)}]"


def type_of(schema: dict[str, Any]) -> str:
    """The Python type of a schema."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        if SCHEMAS[name].get("enum"):
            ENUMERATIONS.add(name)
            return str(name)
        return "dict[str, Any]"
    if "oneOf" in schema or "anyOf" in schema:
        kinds = list(dict.fromkeys(type_of(one) for one in schema.get("oneOf", schema.get("anyOf", []))))
        return " | ".join(sorted(kinds, key=lambda kind: kind == "None"))
    if "enum" in schema:
        return literal(schema["enum"])
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    return " | ".join(one_type(schema, kind) for kind in sorted(kinds, key=lambda kind: kind == "null")) or "Any"


def one_type(schema: dict[str, Any], kind: str) -> str:
    if kind == "null":
        return "None"
    if kind == "array":
        return f"list[{type_of(schema['items'])}]"
    if kind == "object":
        inner = schema.get("additionalProperties")
        return f"dict[str, {type_of(inner)}]" if isinstance(inner, dict) else "dict[str, Any]"
    return "datetime" if schema.get("format") == "date-time" else SCALARS[kind]


def docstring(text: str, indent: str) -> list[str]:
    """A docstring of at most 120 columns. Keeps the paragraphs and list items of the text."""
    text = text.replace("\\", "\\\\")
    paragraphs = re.split(r"\n\n|\n(?=- )", text)
    lines: list[str] = []
    for paragraph in paragraphs:
        is_item = paragraph.startswith("- ")
        if lines and not is_item:
            lines.append("")
        lines += textwrap.wrap(" ".join(paragraph.split()), 112 - len(indent), subsequent_indent="  " * is_item)
    if len(lines) == 1:
        return [f'{indent}"""{lines[0]}"""']
    return [f'{indent}"""{lines[0]}', *(f"{indent}{line}".rstrip() for line in lines[1:]), f'{indent}"""']


def data_class(schema_name: str, name: str) -> list[str]:
    schema = SCHEMAS[schema_name]
    required = set(schema.get("required", []))
    properties = {
        field: value
        for field, value in schema["properties"].items()
        if not value.get("deprecated") and field not in LEFT_OUT.get(schema_name, ())
    }
    lines = ["", "", "@dataclass(frozen=True, slots=True)", f"class {name}({BASES.get(name, 'Model')}):"]
    lines += [*docstring(schema["description"], "    "), ""]
    times = []
    for field in sorted(properties, key=lambda field: field not in required):
        value = properties[field]
        kind = type_of(value)
        if "datetime" in kind:
            times.append(field)
        is_optional = field not in required
        if is_optional and "None" not in kind.split(" | "):
            kind += " | None"
        lines.append(f"    {field}: {kind}{' = None' if is_optional else ''}")
        if "description" in value:
            lines += docstring(value["description"], "    ")
    if times:
        lines += ["", f"    _times: ClassVar[frozenset[str]] = frozenset({times})"]
    return lines


def enumeration(name: str) -> list[str]:
    schema = SCHEMAS[name]
    values = "".join(f"\n    {json.dumps(value)}," for value in schema["enum"])
    lines = ["", f"{name} = Literal[{values}\n]"]
    return lines + (docstring(schema["description"], "") if "description" in schema else [])


def types() -> str:
    """The text of `_types.py`."""
    classes = [line for schema, name in NAMES.items() for line in data_class(schema, name)]
    head = [
        '"""Types of the gateway\'s API. Generated by generate.py: do not edit."""',
        "",
        "# ruff: noqa: E501",
        "",
        "from __future__ import annotations",
        "",
        "from dataclasses import dataclass",
        "from datetime import datetime",
        "from typing import Any, ClassVar, Literal, Union",
        "",
        "from ._model import Model, OtherEvent, Result",
    ]
    enumerations = [line for name in sorted(ENUMERATIONS) for line in enumeration(name)]
    mapping = SCHEMAS["StoredEvent"]["discriminator"]["mapping"]
    kinds = {kind: ref.rpartition("/")[2] for kind, ref in mapping.items()}
    tail = ["", "", f"Event = Union[{', '.join(sorted(EVENTS))}, OtherEvent]"]
    tail += ['"""An event of the journal. `kind` says which one; an event of a kind that is not known is an `OtherEvent`."""']
    tail += ["", "EVENTS: dict[str, type[Model]] = {"]
    tail += [f'    "{kind}": {name},' for kind, name in sorted(kinds.items())] + ["}"]
    return "\n".join(head + enumerations + classes + tail) + "\n"


# From asyncio to synchronous code, in this order.
REPLACEMENTS = [
    (r"Opening\[(\w+)\]", r"\1"),
    (r"import Opening, ", "import "),
    (r"from typing import AsyncIterator", "from typing import Iterator"),
    (r"_call_aio", "_call_sync"),
    (r"__(a)(enter|exit|iter|next)__", r"__\2__"),
    (r"StopAsyncIteration", "StopIteration"),
    (r"\basync (def|with|for) ", r"\1 "),
    (r"\bawait ", ""),
    (r"\bAsync(Iterator|Iterable)\b", r"\1"),
]


def synchronous() -> str:
    """The text of `_sync.py`."""
    text = (PACKAGE / "aio.py").read_text()
    head, _, body = text.partition('"""\n')
    assert head.startswith('"""'), "aio.py has to begin with a docstring"
    for pattern, replacement in REPLACEMENTS:
        body = re.sub(pattern, replacement, body)
    return '"""Synchronous use of a gateway. Generated by generate.py from aio.py: do not edit."""\n' + body


def contents(wheel: Path) -> dict[str, bytes]:
    """The files in a wheel, without those that name the program that built it."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith((".dist-info/WHEEL", ".dist-info/RECORD"))]
        return {name: archive.read(name) for name in names}


def make_wheel(is_check: bool) -> list[str]:
    """Builds the wheel if its contents have changed. Returns the names of wheels that are out of date."""
    with tempfile.TemporaryDirectory() as directory:
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", directory, str(HERE)]
        if importlib.util.find_spec("hatchling"):
            command.append("--no-build-isolation")
        # A fixed time makes the same wheel from the same files.
        subprocess.run(command, check=True, env={**os.environ, "SOURCE_DATE_EPOCH": "1577836800"})
        (built,) = Path(directory).iterdir()
        served = HERE / built.name
        old = [wheel for wheel in HERE.glob("*.whl") if wheel != served]
        is_same = served.exists() and contents(served) == contents(built)
        if is_check:
            return [wheel.name for wheel in old] + ([] if is_same else [served.name])
        for wheel in old:
            wheel.unlink()
        if not is_same:
            served.write_bytes(built.read_bytes())
    return []


def main() -> None:
    is_check = sys.argv[1:] == ["--check"]
    if sys.argv[1:] and not is_check:
        sys.exit(__doc__)
    stale = []
    for name, text in [("_types.py", types()), ("_sync.py", synchronous())]:
        file = PACKAGE / name
        if is_check:
            stale += [name] if not file.exists() or file.read_text() != text else []
        else:
            file.write_text(text)
    stale += make_wheel(is_check)
    if stale:
        sys.exit(f"{', '.join(stale)}: out of date; run {Path(__file__).name} and commit the result")


if __name__ == "__main__":
    main()
