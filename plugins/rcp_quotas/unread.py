"""The quota of unread bytes of the clients of a tenant or principal, and its enforcement."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping

from rcp_kernel.features import FeatureHost
from rcp_kernel.sessions.session import Session
from rcp_quotas.bucket import SWEEP, TokenBucket
from rcp_quotas.usage import QuotaUsage

__all__ = ["UnreadLimit"]


class UnreadLimit:
    """Checks the unread bytes periodically while any quota limits them."""

    def __init__(
        self,
        host: FeatureHost,
        usages: Callable[[], Iterable[QuotaUsage]],
        buckets: Mapping[Session, TokenBucket],
    ) -> None:
        self._host = host
        self._usages = usages
        self._buckets = buckets
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Start checking."""
        if self._timer is None:
            self._timer = self._host.loop.call_later(SWEEP, self._look)

    def close(self) -> None:
        """Stop checking."""
        if self._timer is not None:
            self._timer.cancel()

    def _look(self) -> None:
        self._timer = None
        for usage in list(self._usages()):
            limit = usage.quota.queue_bytes
            if limit is not None:
                self.start()
                self._weigh(usage, limit)

    def _weigh(self, usage: QuotaUsage, limit: int) -> None:
        """Shed data of the slowest clients to meet the quota, or else refuse requests."""
        unread = self._host.unread_bytes
        held = sorted(((unread(s), s) for s in usage.sessions), key=_by_size, reverse=True)
        total = sum(size for size, _ in held)
        usage.waiting = total
        over = total - limit
        reason = (
            f"ended: the clients of this {usage.owner} have more than the {limit} unread bytes of "
            "its quota"
        )
        for size, session in held:
            if over > 0:
                usage.count_refusal("queue_bytes")
                over -= size - self._host.shed(session, reason)
            bucket = self._buckets.get(session)
            if bucket is None:
                continue
            left = over > 0 and unread(session) > 0
            if left:
                bucket.choked = usage
                over -= unread(session)
            elif bucket.choked is usage:
                bucket.choked = None


def _by_size(item: tuple[int, Session]) -> int:
    return item[0]
