"""Leases for clients that know none: acquired where one is required, renewed by use, released after it."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from rcp_foxglove.requests import Requests
from rcp_kernel.wire import Reply, Request

__all__ = ["Leases"]

_LEASES = "/system/leases"
_EARLY = 0.95  # of its duration, before which a lease does not expire by itself
_REASON = "publishes through the Foxglove protocol"


class _Held(NamedTuple):
    lease: str
    since: float
    """When it was acquired or renewed, by the loop's clock."""


class Leases:
    """The leases of one client, by the path that each was acquired for."""

    def __init__(self, requests: Requests, duration: float) -> None:
        self._requests = requests
        self._duration = duration
        self._held: dict[str, _Held] = {}
        self._taken: set[str] = set()
        """Paths whose lease somebody took: only the client itself may ask for it again."""

    def begin(self, path: str) -> None:
        """Allow a lease for a path on which the client begins to publish."""
        self._taken.discard(path)

    def may_acquire(self, path: str) -> bool:
        """Return whether a lease may be acquired for a path."""
        return path not in self._taken

    async def keep(self, path: str) -> None:
        """Renew the lease of a path in time, or acquire it again after a pause."""
        held = self._held.get(path)
        if held is not None and self._now() - held.since > self._duration / 2:
            await self.acquire(path)

    async def acquire(self, path: str) -> Reply | None:
        """Acquire or renew the lease of a path; return the refusal, if it is refused."""
        wish = {"do": "acquire", "scope": path, "ttl": self._duration, "reason": _REASON}
        reply = await self._do(wish)
        if reply.error is not None:
            return reply
        self._held[path] = _Held(_plain(reply.body)["lease"], self._now())
        return None

    def lost(self, lease: str) -> None:
        """Give up a lease that was lost before it expired: somebody took it, or stopped the robot."""
        for path, held in list(self._held.items()):
            if held.lease == lease and self._now() - held.since < _EARLY * self._duration:
                del self._held[path]
                self._taken.add(path)

    def _now(self) -> float:
        return self._requests.client_api.loop.time()

    def release(self, path: str) -> None:
        """Release the lease of a path, if there is one."""
        if (held := self._held.pop(path, None)) is not None:
            self._requests.begin(self._release(held.lease))

    async def _release(self, lease: str) -> None:
        await self._do({"do": "release", "lease": lease})

    async def _do(self, what: dict[str, Any]) -> Reply:
        body = msgspec.Raw(msgspec.json.encode(what))
        return await self._requests.request(Request(type="execute", path=_LEASES, body=body))


def _plain(body: Any) -> dict[str, Any]:
    return msgspec.to_builtins(getattr(body, "value", body))
