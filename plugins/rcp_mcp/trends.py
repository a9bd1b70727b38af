"""Samples as trends: for each number its ends, range, mean and slope; for the rest its changes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime
from typing import Any

from rcp_protocol.plain import is_list, is_map

__all__ = ["trends"]

_MOST = 40  # numbers and texts of one path
_CHANGES = 10
_TIMES = frozenset(("timestamp", "stamp", "seq", "header", "data"))
"""Fields that change with every sample and tell nothing."""


def trends(samples: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one item for each path, from samples with `path`, `value` and `timestamp`."""
    by_path: dict[str, list[dict[str, Any]]] = {}
    for sample in samples:
        by_path.setdefault(sample["path"], []).append(sample)
    return [_trend(path, found) for path, found in by_path.items()]


def _trend(path: str, samples: list[dict[str, Any]]) -> dict[str, Any]:
    series: dict[str, list[tuple[float, Any]]] = {}
    begin = _seconds(samples[0])
    for sample in samples:
        moment = _seconds(sample) - begin
        for name, item in _leaves(sample["value"], ""):
            if name in series or len(series) < _MOST:
                series.setdefault(name, []).append((moment, item))
    told = {name: _told(points) for name, points in series.items()}
    return {
        "path": path,
        "samples": len(samples),
        "seconds": round(_seconds(samples[-1]) - begin, 2),
        "timestamp": samples[-1].get("timestamp"),
        "value": told[""] if [*told] == [""] else told,
    }


def _told(points: list[tuple[float, Any]]) -> Any:
    """Describe one field: a constant as itself."""
    values = [value for _, value in points]
    if all(value == values[0] for value in values):
        return values[0]
    if all(map(_is_number, values)):
        mean = math.fsum(values) / len(values)
        return {
            "first": _short(values[0]),
            "last": _short(values[-1]),
            "min": _short(min(values)),
            "max": _short(max(values)),
            "mean": _short(mean),
            "per_second": _short(_slope(points, mean)),
        }
    changes: list[list[Any]] = []
    for moment, value in points:
        if not changes or value != changes[-1][1]:
            changes.append([round(moment, 2), value])
    return {"changes": changes[-_CHANGES:]}


def _slope(points: list[tuple[float, Any]], mean: float) -> float:
    """Return the slope of the line with the least squares."""
    middle = math.fsum(moment for moment, _ in points) / len(points)
    spread = math.fsum((moment - middle) ** 2 for moment, _ in points)
    if not spread:
        return 0.0
    return math.fsum((moment - middle) * (value - mean) for moment, value in points) / spread


def _leaves(node: Any, name: str) -> Iterator[tuple[str, Any]]:
    if is_map(node):
        for key, item in node.items():
            if key not in _TIMES:
                yield from _leaves(item, f"{name}.{key}" if name else key)
    elif is_list(node):
        for number, item in enumerate(node[:_MOST]):
            yield from _leaves(item, f"{name}[{number}]")
    else:
        yield name, node


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _seconds(sample: dict[str, Any]) -> float:
    text = sample.get("timestamp")
    if not isinstance(text, str):
        return 0.0
    return datetime.fromisoformat(text).timestamp()
