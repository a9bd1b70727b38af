"""What has gone wrong in a feature: what it raised where it should only have listened."""

from __future__ import annotations

from typing import Any

import structlog

__all__ = ["FeatureHealth"]

log = structlog.get_logger("rcp.features")


class FeatureHealth:
    """The faults of one feature since the start of the gateway."""

    __slots__ = ("fault", "faults", "name")

    def __init__(self, name: str) -> None:
        self.name = name
        self.fault: str | None = None
        """What failed last, for people; None as long as nothing did."""
        self.faults = 0

    def failed(self, part: str, error: Exception, **facts: Any) -> None:
        """Note that a part of it raised; the log has the traceback.

        What it raised may name what not everybody may see, so only its type is told.
        """
        self.faults += 1
        self.fault = f"{part} failed: {type(error).__name__}; see the log of the gateway"
        log.error("feature_failed", feature=self.name, part=part, exc_info=error, **facts)
