"""The gateway's notices, and the outcome of `auth`, as status messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from rcp_rosbridge.config import Level
from rcp_rosbridge.status import StatusMessages

__all__ = ["Notices", "tell_outcome"]

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


class Notices:
    """Tells one client what the gateway's notices say."""

    def __init__(
        self,
        status: StatusMessages,
        lost: Callable[[str, str], bool],
        missed: Callable[[], None],
    ) -> None:
        """Call `lost` with a lease that the client lost and who ended it; it returns whether to tell.

        `missed` is called when messages were skipped.
        """
        self._status = status
        self._lost = lost
        self._missed = missed

    def notice(self, code: str, facts: dict[str, Any]) -> None:
        """Tell a notice, if it concerns what clients of rosbridge do."""
        if code == "lease_lost" and not self._lost(str(facts.get("lease")), str(facts.get("by"))):
            return
        level = _LEVELS.get(code)
        if level is None:
            return
        text = str(facts.get("message") or facts.get("reason") or code.replace("_", " "))
        path = facts.get("path") or facts.get("scope")
        self._status.tell(level, f"{path}: {text}" if path else text, None, f"{code} {path}")

    def skipped(self, subscription: str, path: str, count: int) -> None:
        """Have the subscriptions tell it, which count what a client misses that does not read."""
        self._missed()


def tell_outcome(data: bytes, status: StatusMessages) -> None:
    """Tell a client what the reply to its `auth` says."""
    reply: dict[str, Any] = msgspec.json.decode(data)
    id_ = str(reply.get("id") or "").removeprefix("auth:") or None
    error = reply.get("error")
    if error is not None:
        remedy = f" {error['remedy']}" if error.get("remedy") else ""
        status.error(f"authentication failed: {error['message']}{remedy}", id_)
    else:
        status.tell("info", f"authenticated as {reply['body']['principal']}", id_)
