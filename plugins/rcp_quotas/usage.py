"""The quota of one tenant or principal, and its current use.

The rate of requests is limited by the single number that a token bucket needs: the time up to which
requests are paid for.
"""

from __future__ import annotations

from typing import Any, Literal

from rcp_kernel.errors import QueueFull, RateLimited, RcpError
from rcp_kernel.sessions.session import Session
from rcp_quotas.config import Quota

__all__ = ["Owner", "QuotaUsage"]

Owner = Literal["tenant", "principal"]


class QuotaUsage:
    """The quota and use of one tenant or principal."""

    __slots__ = (
        "commands",
        "interval",
        "name",
        "owner",
        "paid",
        "plans",
        "quota",
        "refused",
        "sessions",
        "slack",
        "waiting",
    )

    def __init__(self, owner: Owner, name: str, quota: Quota) -> None:
        self.owner: Owner = owner
        self.name = name
        self.paid = 0.0
        """Time up to which its requests are paid for, in s of `Clock.monotonic`."""
        self.sessions: set[Session] = set()
        self.commands: set[str] = set()
        """Ids of the unfinished commands."""
        self.plans: set[str] = set()
        """Ids of the commands of running plans."""
        self.waiting = 0
        """Unread bytes of its clients at the last check."""
        self.refused: dict[str, int] = {}
        """Number of refusals by resource."""
        self.adopt(quota)

    def adopt(self, quota: Quota) -> None:
        """Apply a new quota; existing use beyond it stays, but nothing is added."""
        self.quota = quota
        self.interval, self.slack = quota.pace

    @property
    def connected(self) -> int:
        """Sessions with a connected client."""
        return sum(1 for session in self.sessions if session.cut is None)

    def check_connected(self) -> None:
        """Check the quota of sessions.

        :raises QueueFull: as many as allowed are connected.
        """
        limit = self.quota.sessions
        if limit is not None and self.connected >= limit:
            raise self.full("sessions", limit)

    @property
    def subscriptions(self) -> int:
        """Number of subscriptions of all its sessions."""
        return sum(len(session.subscriptions) for session in self.sessions)

    def idle(self, moment: float) -> bool:
        """Return whether the usage can be removed without losing information."""
        return not (self.sessions or self.commands or self.plans) and self.paid < moment

    def count_refusal(self, what: str) -> None:
        """Count a refusal."""
        self.refused[what] = self.refused.get(what, 0) + 1

    def full(self, what: str, limit: int) -> QueueFull:
        """Count a refusal and return it; it names the limit, not the other users."""
        self.count_refusal(what)
        return QueueFull(
            f"this {self.owner} already has {limit} {what}, its quota",
            remedy=f"End {what} that you no longer need, or ask the operator for a larger quota.",
            details={"quota": self.owner, "what": what, "limit": limit},
        )

    def too_fast(self, moment: float) -> RcpError:
        """Count a refused request; return the refusal with the time until the next one."""
        self.count_refusal("requests")
        quota = self.quota
        return RateLimited(
            f"this {self.owner} may send {quota.requests:g} requests per second",
            retry_after=round(max(self.paid - self.slack - moment, 0.0) + 0.0005, 3),
            details={
                "quota": self.owner,
                "what": "requests",
                "limit": quota.requests,
                "burst": quota.at_once,
            },
        )

    def plain(self) -> dict[str, Any]:
        """Describe each limited resource: use and limit."""
        quota = self.quota
        used = {
            "sessions": self.connected,
            "subscriptions": self.subscriptions,
            "commands": len(self.commands),
            "plans": len(self.plans),
            "queue_bytes": self.waiting,
        }
        out: dict[str, Any] = {
            what: {"used": count, "limit": getattr(quota, what)}
            for what, count in used.items()
            if getattr(quota, what) is not None
        }
        if quota.requests is not None:
            out["requests"] = {"limit": quota.requests}
        for what, count in self.refused.items():
            out.setdefault(what, {})["refused"] = count
        return out
