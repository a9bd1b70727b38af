"""Laser scans as the nearest obstacle by sector."""

from __future__ import annotations

import math
from typing import Any

from rcp_protocol.plain import is_list, is_map

__all__ = ["SECTORS", "is_scan", "sector_of", "sectors", "told"]

SECTORS = (
    "front",
    "front_left",
    "left",
    "back_left",
    "back",
    "back_right",
    "right",
    "front_right",
)
_WIDTH = 2 * math.pi / len(SECTORS)
_KEPT = ("frame_id", "header", "timestamp", "range_max")


def is_scan(node: Any) -> bool:
    """Return whether a value is a laser scan."""
    return (
        is_map(node)
        and is_list(node.get("ranges"))
        and all(isinstance(node.get(key), (int, float)) for key in ("angle_min", "angle_increment"))
    )


def sectors(scan: dict[str, Any]) -> dict[str, Any]:
    """Return the nearest obstacle of each sector: distance in m, bearing in degrees to the left.

    A sector without one within the scanner's range is None; one that the scanner does not see is
    left out.
    """
    low, high = _number(scan.get("range_min"), 0.0), _number(scan.get("range_max"), math.inf)
    begin, step = scan["angle_min"], scan["angle_increment"]
    best: dict[str, tuple[float, float] | None] = {}
    for number, distance in enumerate(scan["ranges"]):
        angle = math.remainder(begin + number * step, 2 * math.pi)
        name = sector_of(angle)
        known = best.setdefault(name, None)
        if (
            isinstance(distance, (int, float))
            and low <= distance <= high
            and math.isfinite(distance)
            and (known is None or distance < known[0])
        ):
            best[name] = distance, angle
    return {
        "nearest_by_sector": {
            name: None if (one := best[name]) is None else told(*one)
            for name in SECTORS
            if name in best
        },
        "beams": len(scan["ranges"]),
        **{key: scan[key] for key in _KEPT if scan.get(key) is not None},
    }


def sector_of(angle: float) -> str:
    """Return the sector of a bearing, rad to the left."""
    return SECTORS[round(angle / _WIDTH) % len(SECTORS)]


def told(distance: float, angle: float) -> dict[str, float]:
    """Return an obstacle as a model reads it."""
    return {"m": round(distance, 2), "deg": round(math.degrees(angle))}


def _number(given: Any, other: float) -> float:
    return float(given) if isinstance(given, (int, float)) else other
