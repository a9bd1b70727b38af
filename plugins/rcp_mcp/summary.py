"""Summaries of large values: long lists are replaced by their length, ends and range."""

from __future__ import annotations

import re
from typing import Any

import msgspec

from rcp_protocol.plain import is_list, is_map

__all__ = ["PER_TOKEN", "cut", "size"]

PER_TOKEN = 3  # bytes of JSON per token, at least; numbers are dense
_LEVELS = ((16, 400), (6, 120), (2, 40), (0, 16))  # list items, text length
_DEEP = 12
_BLOB = re.compile(r"[A-Za-z0-9+/]{64,}={0,2}\Z")


def size(plain: Any) -> int:
    """Return the size of a plain value as JSON, in bytes."""
    return len(msgspec.json.encode(plain))


def cut(plain: Any, budget: int) -> Any:
    """Return a summary of a plain value with at most about `budget` tokens."""
    found: Any = None
    for items, characters in _LEVELS:
        found = _cut(plain, items, characters, _DEEP)
        if size(found) <= budget * PER_TOKEN:
            return found
    return {"of": type(found).__name__, "bytes": size(plain)}


def _cut(node: Any, items: int, characters: int, deep: int) -> Any:
    if isinstance(node, str):
        if len(node) <= characters:
            return node
        if _BLOB.match(node):
            return f"({len(node) * 3 // 4} bytes as base64)"
        return f"{node[:characters]}… ({len(node)} characters)"
    if is_list(node):
        return _cut_list(node, items, characters, deep)
    if not is_map(node):
        return node
    if deep == 0:
        return {"fields": len(node)}
    kept = list(node.items())[: max(items, 1) * 4]
    out = {key[:characters]: _cut(item, items, characters, deep - 1) for key, item in kept}
    if len(node) > len(kept):
        out["…"] = f"{len(node) - len(kept)} more fields"
    return out


def _cut_list(node: list[Any], items: int, characters: int, deep: int) -> Any:
    if deep == 0:
        return {"length": len(node)}
    if len(node) <= items:
        return [_cut(item, items, characters, deep - 1) for item in node]
    facts: dict[str, Any] = {"length": len(node)}
    numbers = [n for n in node if isinstance(n, (int, float)) and not isinstance(n, bool)]
    if len(numbers) * 2 > len(node):
        mean = sum(numbers) / len(numbers)
        facts |= {"min": min(numbers), "max": max(numbers), "mean": round(mean, 6)}
        if len(numbers) < len(node):
            facts["other"] = len(node) - len(numbers)
    first = max(items // 4, 1) if items else 0
    facts["first"] = [_cut(item, items // 4, characters, deep - 1) for item in node[:first]]
    return facts
