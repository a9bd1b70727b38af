"""What can be wrong, in the words of each version of VDA 5050."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct

__all__ = ["DownloadFailed", "Fault", "FaultKind", "OrderRefused"]

FaultKind = Literal[
    "malformed", "action", "instant_action", "outdated", "other_order", "stitching", "start", "map",
    "no_order", "drive", "work", "unavailable", "route", "cancelled", "same_update", "blocked", "release",
    "lost", "duplicate_zone_set", "memory", "unsupported", "zones_lost", "zone_set_lost", "not_stored",
    "not_enabled",
]  # fmt: skip
TYPES: Mapping[str, tuple[str, str]] = {
    "malformed": ("validationError", "VALIDATION_FAILURE"),
    "action": ("orderError", "INVALID_ORDER_ACTION"),
    "instant_action": ("instantActionError", "INVALID_INSTANT_ACTION"),
    "outdated": ("orderUpdateError", "OUTDATED_ORDER_UPDATE"),
    "other_order": ("orderError", "OTHER_ORDER_ACTIVE"),
    "stitching": ("orderUpdateError", "VALIDATION_FAILURE"),
    "start": ("noRouteError", "START_NODE_OUT_OF_RANGE"),
    "map": ("orderError", "UNKNOWN_MAP_ID"),
    "no_order": ("noOrderToCancel", "NO_ORDER_TO_CANCEL"),
    "drive": ("noRouteError", "NODE_UNREACHABLE"),
    "work": ("actionError", "ACTION_FAILURE"),
    "unavailable": ("robotNotAvailable", "MOBILE_ROBOT_NOT_AVAILABLE"),
    "route": ("noRouteError", "NO_ROUTE_TO_TARGET"),
    "cancelled": ("orderUpdateError", "ORDER_UPDATE_FOLLOWING_CANCEL"),
    "same_update": ("orderUpdateError", "SAME_ORDER_UPDATE_ID"),
    "blocked": ("zoneError", "BLOCKED_ZONE_VIOLATION"),
    "release": ("zoneError", "RELEASE_LOST"),
    "lost": ("localizationError", "LOCALIZATION_ERROR"),
    "duplicate_zone_set": ("zoneError", "DUPLICATE_ZONE_SET"),
    "memory": ("zoneError", "INSUFFICIENT_MEMORY"),
    "unsupported": ("orderError", "UNSUPPORTED_PARAMETER"),
    "zones_lost": ("zoneError", "ZONES_NOT_KNOWN"),
    "zone_set_lost": ("zoneError", "ZONE_SET_LOST"),
    "not_stored": ("zoneError", "ZONE_SET_NOT_STORED"),
    "not_enabled": ("actionError", "NOT_ENABLED"),
}
"""`errorType` of 2.1 and of 3.0."""
_LEVELS: Mapping[str, str] = {
    "drive": "CRITICAL", "unavailable": "CRITICAL", "blocked": "CRITICAL", "release": "CRITICAL",
    "lost": "FATAL", "memory": "URGENT", "unsupported": "CRITICAL", "zones_lost": "FATAL", "not_stored": "URGENT",
    "not_enabled": "CRITICAL",
}  # fmt: skip
"""Levels of 3.0 that are not WARNING."""
_STOPPING = ("drive", "unavailable", "blocked", "release", "lost", "not_enabled")
"""With these the order does not go on by itself."""


class Fault(Struct, frozen=True):
    """One error of the state."""

    kind: FaultKind
    text: str
    references: tuple[tuple[str, str], ...] = ()
    hint: str = ""

    def written(self, version: str) -> dict[str, object]:
        """Return it as an element of `errors`."""
        newer = version == "3.0"
        level = _LEVELS.get(self.kind, "WARNING")
        if not newer:  # which has two levels
            level = "FATAL" if self.kind in _STOPPING else "WARNING"
        found: dict[str, object] = {
            "errorType": TYPES[self.kind][newer],
            "errorLevel": level,
            "errorDescription": self.text,
            "errorReferences": [
                {"referenceKey": key, "referenceValue": value} for key, value in self.references
            ],
        }
        return found | ({"errorHint": self.hint} if self.hint else {})


class OrderRefused(Exception):
    """An order is refused as a whole; nothing of it is done."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.text)
        self.fault = fault


class DownloadFailed(Exception):
    """Nothing was downloaded that may be used."""
