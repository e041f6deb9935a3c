"""Normal form of tool calls as clients send them.

Clients differ in how they write one and the same call. The differences in the table are removed before a call is read,
so they cost nothing. A choice that does not exist stays as it is, and costs a primitive.

| client sends | read as |
|---|---|
| `"3"`, `3.0` for a whole number | `3` |
| `null` for an argument that may be left out, or for all arguments | left out |
| `'{"option": "go-to-exit"}'`, a JSON text of the arguments | the arguments |
| `mcp__rooms__run_option`, `rooms.run_option`, `functions:run_option` | `run_option` |
| `_meta` among the arguments | left out |
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

_WHOLE = re.compile(r"\s*[+-]?[0-9]{1,9}(?:\.0*)?\s*")
_PREFIX = re.compile(r"__|[.:/]")


def normalise_call(name: Any, arguments: Any, tools: Sequence[Mapping[str, Any]]) -> tuple[Any, Any]:
    """Return name and arguments of a call in normal form; what cannot be normalised is returned unchanged.

    Args:
        name: name of the tool as sent, of any type.
        arguments: arguments as sent, of any type.
        tools: JSON Schemas of the tools, see `RoomSession.tools`.
    """
    schemas = {tool["name"]: tool["inputSchema"] for tool in tools}
    if isinstance(name, str) and name not in schemas:
        last = _PREFIX.split(name)[-1]
        name = last if last in schemas else name
    if isinstance(arguments, str):
        arguments = _parse_object(arguments)
    if arguments is None:
        arguments = {}
    schema = schemas.get(name) if isinstance(name, str) else None
    if schema is None or not isinstance(arguments, Mapping):
        return name, arguments
    properties, required = schema["properties"], schema["required"]
    normal = {}
    for key, value in arguments.items():
        if key == "_meta" or (value is None and key in properties and key not in required):
            continue
        normal[key] = _read_whole(value) if properties.get(key, {}).get("type") == "integer" else value
    return name, normal


def _parse_object(text: str) -> Any:
    """Value of a JSON text if it is an object or null; otherwise the text."""
    try:
        value = json.loads(text) if text.strip() else None
    except (ValueError, RecursionError):
        return text
    return value if value is None or isinstance(value, dict) else text


def _read_whole(value: Any) -> Any:
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        return int(float(value))
    if type(value) is float and value.is_integer() and abs(value) < 2**53:
        return int(value)
    return value
