"""Leases for clients that know none: acquired where one is required, renewed by use, released after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.values import to_plain
from rcp_kernel.wire import Body, Reply, Request
from rcp_rosbridge.context import Context

__all__ = ["Leases"]

_LEASES = "/system/leases"
_GATEWAY = "the gateway"  # who ends a lease that expires
_REASON = "publishes by rosbridge"


class _Held(NamedTuple):
    lease: str
    since: float
    """When it was acquired or renewed, by the loop's clock."""


class Leases:
    """The leases of one client, by the path that each was acquired for."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._held: dict[str, _Held] = {}

    def keep(self, path: str) -> None:
        """Renew the lease of a path in time, or acquire it again after a pause."""
        held = self._held.get(path)
        if held is not None and self._now() - held.since > self._context.config.lease / 2:
            self.acquire(path, lambda _: None)

    def may_help(self, path: str, code: str) -> bool:
        """Return whether a command that was refused passes under a lease that nobody took away."""
        return code == "lease_required" or (code == "lease_lost" and path in self._held)

    def acquire(self, path: str, then: Callable[[Reply | None], None]) -> None:
        """Acquire or renew the lease of a path; call `then` with the refusal, or None."""
        seconds = self._context.config.lease
        wish = {"do": "acquire", "scope": path, "ttl": seconds, "reason": _REASON}

        def answer(reply: Reply) -> None:
            if not reply.final:
                return
            if reply.error is None:
                body: Any = reply.body.value if isinstance(reply.body, Body) else reply.body
                self._held[path] = _Held(to_plain(body)["lease"], self._now())
            then(None if reply.error is None else reply)

        self._do(wish, answer)

    def lost(self, lease: str, by: str) -> bool:
        """Give up a lease that somebody has taken: only the client itself may ask for it again.

        Return whether somebody has; one that has expired is acquired again when it is needed.
        """
        taken = by != _GATEWAY
        if taken:
            self._held = {path: held for path, held in self._held.items() if held.lease != lease}
        return taken

    def release(self, path: str) -> None:
        """Release the lease of a path, if there is one."""
        held = self._held.pop(path, None)
        if held is not None:
            self._do({"do": "release", "lease": held.lease}, lambda _: None)

    def _now(self) -> float:
        return self._context.client_api.loop.time()

    def _do(self, what: dict[str, Any], answer: Callable[[Reply], None]) -> None:
        body = msgspec.Raw(msgspec.json.encode(what))
        self._context.request(Request(type="execute", path=_LEASES, body=body), answer)
