"""Parts of request envelopes: plain values and idempotency keys."""

from __future__ import annotations

import secrets
from typing import Any

import msgspec

from rcp_client.calls import Repeat

__all__ = ["hold_path", "kept", "keyed", "new_key", "plain", "repeat_of"]


def kept(fields: dict[str, Any]) -> dict[str, Any]:
    """Drop the fields that are None."""
    return {key: item for key, item in fields.items() if item is not None}


def hold_path(robot: str | None) -> str:
    """Return the path of `service/hold` for a name or `/tenant/<tenant>[/<robot>]`."""
    if robot is None:
        return "/service/hold"
    if not robot.startswith("/"):
        return f"/service/{robot}/hold"
    parts = robot.split("/")  # "", "tenant", name of the tenant, name of the robot
    return "/".join((*parts[:3], "service", *parts[3:], "hold"))


def plain(value: Any) -> Any:
    """Copy a value to plain data, so that a repeated request is identical to the first."""
    return msgspec.to_builtins(value, builtin_types=(bytes, bytearray, memoryview), str_keys=True)


def new_key() -> str:
    """Return a new unique key."""
    return secrets.token_urlsafe(16)


def keyed(envelope: dict[str, Any]) -> dict[str, Any]:
    """Add a key to a write or execute that has none."""
    if envelope.get("type") not in ("write", "execute") or "idempotency_key" in envelope:
        return dict(envelope)
    return {**envelope, "idempotency_key": new_key()}


def repeat_of(envelope: dict[str, Any]) -> Repeat:
    """Return how a request may be repeated after a lost connection."""
    if envelope.get("type") not in ("write", "execute", "batch"):
        return "always"
    if envelope.get("path") != "/system/estop":
        return "keyed"
    # Stopping twice does no harm; a late reset might undo another person's stop.
    return "never" if (envelope.get("body") or {}).get("reset") else "always"
