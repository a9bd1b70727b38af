"""Errors of a feature's listeners, which must not affect the gateway."""

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
        """The last failure, as text; None if nothing failed."""
        self.faults = 0

    def failed(self, part: str, error: Exception, **facts: Any) -> None:
        """Record that a part raised; the log has the traceback.

        The exception's text may be confidential, so only its type is reported.
        """
        self.faults += 1
        self.fault = f"{part} failed: {type(error).__name__}; see the log of the gateway"
        log.error("feature_failed", feature=self.name, part=part, exc_info=error, **facts)
