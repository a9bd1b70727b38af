"""What a request carries beside its words: plain values, a key against doing it twice."""

from __future__ import annotations

import secrets
from typing import Any

import msgspec

from rcp_client.calls import Repeat

__all__ = ["hold_path", "kept", "keyed", "new_key", "plain", "repeat_of"]


def kept(fields: dict[str, Any]) -> dict[str, Any]:
    """Leave out what was not given."""
    return {key: item for key, item in fields.items() if item is not None}


def hold_path(robot: str | None) -> str:
    """Return the path of a robot's `service/hold`: of a name, or of `/tenant/<tenant>[/<robot>]`."""
    if robot is None:
        return "/service/hold"
    if not robot.startswith("/"):
        return f"/service/{robot}/hold"
    parts = robot.split("/")  # "", "tenant", the tenant's name, and the robot's
    return "/".join((*parts[:3], "service", *parts[3:], "hold"))


def plain(value: Any) -> Any:
    """Copy a value into plain data, so that what is sent again is what was sent first."""
    return msgspec.to_builtins(value, builtin_types=(bytes, bytearray, memoryview), str_keys=True)


def new_key() -> str:
    """Make a key that no other request has."""
    return secrets.token_urlsafe(16)


def keyed(envelope: dict[str, Any]) -> dict[str, Any]:
    """Give a write or execute a key, unless it has one."""
    if envelope.get("type") not in ("write", "execute") or "idempotency_key" in envelope:
        return dict(envelope)
    return {**envelope, "idempotency_key": new_key()}


def repeat_of(envelope: dict[str, Any]) -> Repeat:
    """Say what may be done with a request that a cut left without an answer."""
    if envelope.get("type") not in ("write", "execute", "batch"):
        return "always"
    if envelope.get("path") != "/system/estop":
        return "keyed"
    # Stopping twice is stopping; a reset that comes late might undo somebody else's stop.
    return "never" if (envelope.get("body") or {}).get("reset") else "always"
