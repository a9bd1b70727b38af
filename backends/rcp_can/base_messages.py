"""The event of a differential drive."""

from __future__ import annotations

from msgspec import Struct

__all__ = ["DriveStopped"]


class DriveStopped(Struct, frozen=True, kw_only=True):
    """A wheel lost its set-point, so both were stopped."""

    motor: str
    reason: str
    """Code of the error: `adapter_unavailable`, `mode_forbids`, …"""
    text: str
