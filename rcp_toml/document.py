"""TOML as `tomllib` reads it, without what it or a reader of its result fails at."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from typing import Any

from rcp_protocol.plain import is_list, is_map

__all__ = ["document"]

_DEEPEST = 64
"""Tables and lists in each other; those who read them call themselves."""
_TOO_LONG = re.compile(r"[0-9][0-9_]{4299}")


def document(text: str) -> dict[str, Any]:
    """Read a document.

    :raises tomllib.TOMLDecodeError: it is none, with the line in the text.
    """
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # what Python refuses to convert
        number = _TOO_LONG.search(text)
        line = text.count("\n", 0, number.start()) + 1 if number else 1
        raise tomllib.TOMLDecodeError(f"Too many digits (at line {line}, column 1)") from None
    except RecursionError:
        found = None
    if found is None or _is_deep(found):
        lines = text.split("\n")
        line = max(range(len(lines)), key=lambda one: _depth(lines[one])) + 1
        what = "Lists or tables are nested too deep"
        raise tomllib.TOMLDecodeError(f"{what} (at line {line}, column 1)")
    return found


def _is_deep(root: dict[str, Any]) -> bool:
    level: list[Any] = [root]
    for _ in range(_DEEPEST):
        level = [item for node in level for item in _items(node)]
        if not level:
            return False
    return True


def _items(node: Any) -> Iterable[Any]:
    if is_map(node):
        return node.values()
    return node if is_list(node) else ()


def _depth(line: str) -> int:
    """Return about how deep a line goes."""
    return sum(map(line.count, "[{."))
