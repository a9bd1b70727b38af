"""Parts of request envelopes, and whether they may be repeated."""

from __future__ import annotations

import re
import secrets
from typing import Any, Literal

import msgspec

__all__ = [
    "Repeat",
    "concerns_gateway",
    "hold_path",
    "kept",
    "keyed",
    "new_key",
    "plain",
    "repeat_of",
    "repeatable",
]

Repeat = Literal["always", "keyed", "never"]
"""What happens to a sent request when the connection is lost: it is sent again; it is sent again if
the gateway still knows its idempotency key; or it ends, because repeating it would be wrong."""

_HOLD = re.compile(r"(/tenant/[^/]+)?/service/([^/]+/)?hold")


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
    """Add a key to a write or execute that has none, also within a batch."""
    if parts := _parts(envelope):
        return {**envelope, "body": [keyed(part) for part in parts]}
    if not _acts(envelope) or envelope.get("idempotency_key") is not None:
        return dict(envelope)
    return {**envelope, "idempotency_key": new_key()}


def repeat_of(envelope: dict[str, Any]) -> Repeat:
    """Return how a request may be repeated after a lost connection."""
    if envelope.get("type") == "batch":
        return "never" if "never" in map(repeat_of, _parts(envelope)) else "keyed"
    if not _acts(envelope):
        return "always"
    if envelope.get("path") != "/system/estop":
        return "keyed"
    # Stopping twice does no harm; a late reset might undo another person's stop.
    return "always" if _stops(envelope) else "never"


def repeatable(envelope: dict[str, Any], *, keys: bool) -> bool:
    """Return whether a repeat does no harm if the request was sent and its outcome is unknown.

    `keys` tells whether the gateway still knows the idempotency keys.
    """
    if envelope.get("type") == "batch":
        return all(repeatable(part, keys=keys) for part in _parts(envelope))
    if not _acts(envelope) or envelope.get("dry_run") or _stops(envelope):
        return True
    return keys and envelope.get("idempotency_key") is not None


def concerns_gateway(envelope: dict[str, Any]) -> bool:
    """Return whether a request asks anything of the gateway itself, such as a plan."""
    if parts := _parts(envelope):
        return any(map(concerns_gateway, parts))
    return (envelope.get("path") or "").startswith("/system/")


def _parts(envelope: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the requests of a batch; a malformed one is for the gateway to refuse."""
    body = envelope.get("body") if envelope.get("type") == "batch" else None
    whole = isinstance(body, list) and all(isinstance(part, dict) for part in body)  # pyright: ignore[reportUnknownVariableType]
    return body if whole else []  # pyright: ignore[reportUnknownVariableType, reportReturnType]


def _acts(envelope: dict[str, Any]) -> bool:
    return envelope.get("type") in ("write", "execute")


def _stops(envelope: dict[str, Any]) -> bool:
    """Return whether all it does is to stop robots."""
    path = envelope.get("path") or ""
    if path == "/system/estop":
        return not (envelope.get("body") or {}).get("reset")
    return envelope.get("type") == "execute" and _HOLD.fullmatch(path) is not None
