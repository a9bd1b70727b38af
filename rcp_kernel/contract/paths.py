"""Paths of the gateway itself that several parts know."""

from __future__ import annotations

__all__ = ["ESTOP"]

ESTOP = "/system/estop"
"""The e-stop: requests to it are never limited, and its replies are sent whatever else waits."""
