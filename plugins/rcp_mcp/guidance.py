"""What a model meant by a path that is wrong: the nearest ones that it may see."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable, Sequence
from difflib import SequenceMatcher
from typing import Any

from mcp import types

from rcp_mcp.catalogue import Facts

__all__ = ["nearest", "with_nearest"]

_WRONG = frozenset(("unknown_path", "invalid_path"))
_SHOWN = 3
_COMPARED = 32  # paths that are compared letter by letter, which takes 0.1 ms each
_LIKE = 0.55  # least likeness of a path without a common word
_LONGEST = 512  # characters
_WORDS = re.compile(r"[a-z0-9]+")


def nearest(wrong: str, paths: Iterable[str]) -> list[str]:
    """Return the paths that are most like a wrong one: by common words, then by letters."""
    wanted = wrong.lower()[:_LONGEST]
    words = {*_WORDS.findall(wanted)} - {"tenant"}
    end = wanted.rpartition("/")[2][:1]
    ranked: list[tuple[int, bool, str]] = []
    for path in paths:
        common = len(words.intersection(_WORDS.findall(path)))
        ranked.append((common, path.rpartition("/")[2][:1] == end, path))
    ranked.sort(key=lambda one: (-one[0], not one[1], one[2]))
    likeness = {
        path: SequenceMatcher(None, wanted, path, autojunk=False).ratio()
        for _, _, path in ranked[:_COMPARED]
    }
    best = sorted(ranked[:_COMPARED], key=lambda one: -(one[0] + 2 * likeness[one[2]]))
    return [path for common, _, path in best if common or likeness[path] > _LIKE][:_SHOWN]


async def with_nearest(
    result: types.CallToolResult, asked: Sequence[str], facts: Sequence[Facts]
) -> types.CallToolResult:
    """Add to the refusal of a wrong path those that the caller may have meant."""
    error: Any = (result.structured_content or {}).get("error")
    if not isinstance(error, dict) or error.get("code") not in _WRONG:  # pyright: ignore[reportUnknownMemberType]
        return result
    wrong: Any = error.get("path") or next(iter(asked), None)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    if not isinstance(wrong, str):
        return result
    found = await asyncio.to_thread(nearest, wrong, [one["path"] for one in facts])
    if found:
        error["nearest"] = found
        words = f"The nearest paths are: {', '.join(found)}."
        result.content = [*result.content, types.TextContent(type="text", text=words)]
    return result
