"""Status messages: what went wrong, in words, as long as it is so."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Literal

import msgspec

from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.wire import Reply

__all__ = ["ERROR", "INFO", "WARNING", "Statuses", "refusal_text"]

INFO, WARNING, ERROR = 0, 1, 2
Level = Literal[0, 1, 2]
_STANDING = 256  # problems that a client is shown at the same time
_BURST = 20  # single messages in a period
_OPERATION = "See the description of the operation in the Foxglove WebSocket protocol."
_PERIOD = 1.0  # s


def refusal_text(error: RcpError | Reply) -> str:
    """Return what went wrong and what to do next."""
    if isinstance(error, RcpError):
        remedy = _OPERATION if error.remedy == BadRequest.default_remedy else error.remedy
        parts = [error.message, remedy]
    else:
        facts = error.error or {}
        parts = [facts.get("message") or error.message or error.status, facts.get("remedy")]
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)


class Statuses:
    """The status messages of one client.

    A problem with an id is shown until it is removed, and told again only in other words. What
    has none happened once; more than a few in a second are counted instead of told.
    """

    def __init__(self, put: Callable[[bytes], None], loop: asyncio.AbstractEventLoop) -> None:
        self._put = put
        self._loop = loop
        self._standing: dict[str, tuple[int, str]] = {}
        self._told = 0
        self._untold = 0
        self._timer: asyncio.TimerHandle | None = None

    def tell(self, message: str, level: Level = ERROR) -> None:
        """Tell what happened once."""
        if self._told >= _BURST:
            self._untold += 1
            return
        self._told += 1
        if self._timer is None:
            self._timer = self._loop.call_later(_PERIOD, self._renew)
        self._send(level, message, None)

    def show(self, id_: str, message: str, level: Level = ERROR) -> None:
        """Show a problem that lasts."""
        if self._standing.get(id_) == (level, message):
            return
        if id_ not in self._standing and len(self._standing) >= _STANDING:
            self.tell(message, level)
            return
        self._standing[id_] = (level, message)
        self._send(level, message, id_)

    def remove(self, id_: str) -> None:
        """Remove a problem that is over."""
        if self._standing.pop(id_, None) is not None:
            self._put(msgspec.json.encode({"op": "removeStatus", "statusIds": [id_]}))

    def _renew(self) -> None:
        self._timer = None
        untold, self._told, self._untold = self._untold, 0, 0
        if untold:
            self.tell(f"{untold} further messages of this client were refused.")

    def _send(self, level: int, message: str, id_: str | None) -> None:
        facts: dict[str, object] = {"op": "status", "level": level, "message": message}
        if id_ is not None:
            facts["id"] = id_
        self._put(msgspec.json.encode(facts))

    def close(self) -> None:
        """Send nothing more."""
        if self._timer is not None:
            self._timer.cancel()
