"""Plans as lines of the command syntax: `execute /action/move_to {"x": 1}`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest, InvalidValue, RcpError
from rcp_kernel.features import ServiceKey
from rcp_plans.fault import Fault
from rcp_plans.model import Execute, Read, Step, Write
from rcp_protocol.plain import is_map

__all__ = ["LINES", "from_lines", "plain_steps", "word"]

LINES: ServiceKey[Callable[[str], list[dict[str, Any]]]] = ServiceKey("plans.lines")
"""Translates commands, one per line, into the steps of a plan as plain data."""

_LINE = re.compile(r"(?P<do>\S+)\s+(?P<path>\S+)(?:\s+(?P<rest>.*\S))?\s*\Z", re.DOTALL)
_PAIR = re.compile(r"([A-Za-z_][\w.]*)=(\"(?:[^\"\\]|\\.)*\"|\S+)(?:\s+|\Z)")
_SYNTAX = "Use `read|write|execute <path> [value]`; a value is JSON, or name=value pairs."


def from_lines(text: str, most: int | None = None) -> tuple[list[Step], list[Fault]]:
    """Translate commands, one per line, at most `most` of them; `#` begins a comment line."""
    steps: list[Step] = []
    faults: list[Fault] = []
    for number, line in islice(_lines(text), most):
        try:
            steps.append(_command(line, str(len(steps) + len(faults) + 1)))
        except RcpError as error:
            faults.append(Fault(f"line {number}", error))
    return steps, faults


def plain_steps(text: str) -> list[dict[str, Any]]:
    """Translate commands into steps as plain data; invalid lines are skipped."""
    return [msgspec.to_builtins(step) for step in from_lines(text)[0]]


def _lines(text: str) -> Iterable[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield number, stripped


def _command(line: str, id_: str) -> Step:
    match = _LINE.match(line)
    if match is None:
        raise BadRequest(f"{line[:80]!r} is not a command", remedy=_SYNTAX)
    do, path, rest = match["do"].lower(), match["path"], match["rest"]
    value = None if rest is None else _value(rest)
    match do:
        case "read":
            return Read(id=id_, path=path, value=value)
        case "write" if rest is not None:
            return Write(id=id_, path=path, value=value)
        case "write":
            raise InvalidValue(f"`{line[:80]}` has no value to write", path=path, remedy=_SYNTAX)
        case "execute":
            return Execute(id=id_, path=path, value=value)
        case _:
            raise BadRequest(f"'{match['do'][:40]}' is not an operation of plans", remedy=_SYNTAX)


def _value(text: str) -> Any:
    """Parse JSON, or pairs such as `x=1 label="a b"`; a dot in a name selects a nested field."""
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError):
        pass
    out: dict[str, Any] = {}
    place = 0
    while pair := _PAIR.match(text, place):
        *parents, last = pair[1].split(".")
        inner = out
        for step in parents:
            child = inner.setdefault(step, {})
            if not is_map(child):
                raise InvalidValue(f"'{pair[1]}' is both a value and an object")
            inner = child
        inner[last] = word(pair[2])
        place = pair.end()
    if place < len(text):
        raise InvalidValue(f"{text[:80]!r} is neither JSON nor name=value pairs", remedy=_SYNTAX)
    return out


def word(text: str) -> Any:
    """Parse a number, a boolean or a quoted string; anything else is a string."""
    try:
        found = msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return text
    return text if isinstance(found, (dict, list)) else found
