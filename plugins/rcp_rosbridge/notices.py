"""The gateway's notices, as status messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from rcp_rosbridge.config import Level
from rcp_rosbridge.status import StatusMessages

__all__ = ["explained"]

_LEVELS: dict[str, Level] = {
    "stale": "warning",
    "resource_added": "info",
    "resource_removed": "warning",
    "paused": "warning",
    "resumed": "info",
    "fence_left": "error",
    "overrun": "error",
    "lease_lost": "error",
    "lease_given": "info",
}


def explained(data: bytes, status: StatusMessages, lost: Callable[[str, str], bool]) -> None:
    """Tell a client what a notice, or the reply to `hello`, says.

    `lost` is called with a lease that the client lost and who ended it; it returns whether to tell.
    """
    found: dict[str, Any] = msgspec.json.decode(data)
    if found["type"] == "hello":
        _tell_outcome(found, status)
        return
    code = str(found.get("code", ""))
    if code == "lease_lost" and not lost(str(found.get("lease")), str(found.get("by"))):
        return
    level = _LEVELS.get(code)
    if level is None:
        return
    text = str(found.get("message") or found.get("reason") or code.replace("_", " "))
    path = found.get("path") or found.get("scope")
    status.tell(level, f"{path}: {text}" if path else text, None, f"{code} {path}")


def _tell_outcome(reply: dict[str, Any], status: StatusMessages) -> None:
    id_ = str(reply.get("id") or "").removeprefix("auth:") or None
    error = reply.get("error")
    if error is not None:
        remedy = f" {error['remedy']}" if error.get("remedy") else ""
        status.error(f"authentication failed: {error['message']}{remedy}", id_)
    else:
        status.tell("info", f"authenticated as {reply['body']['principal']}", id_)
