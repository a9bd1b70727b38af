"""What one tenant or principal may have of the gateway and has, and what its requests pass.

Requests are paced by the one number that a token bucket needs: the time up to which an account's
requests are paid for.
"""

from __future__ import annotations

from collections.abc import Sized
from typing import Any, Generic, Literal, Protocol, TypeVar

import msgspec

from rcp_kernel.config.limits import Quota
from rcp_kernel.errors import QueueFull, RateLimited, RcpError
from rcp_kernel.values import value_type
from rcp_kernel.wire import Request

__all__ = [
    "NONE",
    "SWEEP",
    "Owner",
    "QuotaUsage",
    "TokenBucket",
    "is_exempt",
]

SWEEP = 0.25  # s between looks at what waits
_ESTOP = "/system/estop"
_LEASES = "/system/leases"
_RELEASE = 2048  # bytes of a release at most
NONE = Quota()
Owner = Literal["tenant", "principal"]


class _Asked(msgspec.Struct, frozen=True):
    """What of a lease request tells whether it lets go."""

    do: str


_ASKED = value_type(_Asked)


def is_exempt(request: Request) -> bool:
    """Tell whether a request stops something or lets go: such are never limited and cost nothing."""
    if request.type != "execute":
        return request.type == "cancel"
    return request.path == _ESTOP or (request.path == _LEASES and _releases(request))


def _releases(request: Request) -> bool:
    if len(bytes(request.body)) > _RELEASE:
        return False
    try:
        return request.decode_body(_ASKED, "release").do == "release"
    except RcpError:
        return False


class Counted(Protocol):
    """A session, as far as it is counted here."""

    cut: int | None

    @property
    def subscriptions(self) -> Sized:
        """What it has subscribed to."""
        ...


S = TypeVar("S", bound=Counted)


class QuotaUsage(Generic[S]):
    """What one tenant or principal may have, and has."""

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
        """Up to when the requests so far have used this account's share, `perf_counter` seconds."""
        self.sessions: set[S] = set()
        self.commands: set[str] = set()
        """Ids of those that have not ended."""
        self.plans: set[str] = set()
        """Ids of the commands of those that run."""
        self.waiting = 0
        """Bytes that waited for its clients at the last look."""
        self.refused: dict[str, int] = {}
        """How often more was refused, by what."""
        self.adopt(quota)

    def adopt(self, quota: Quota) -> None:
        """Put another quota into force; what is held beyond it stays, and nothing is added."""
        self.quota = quota
        self.interval, self.slack = quota.pace

    @property
    def connected(self) -> int:
        """Sessions whose client is there."""
        return sum(1 for session in self.sessions if session.cut is None)

    @property
    def subscriptions(self) -> int:
        """Subscriptions of all its sessions."""
        return sum(len(session.subscriptions) for session in self.sessions)

    def idle(self, moment: float) -> bool:
        """Tell whether nothing would be lost with it."""
        return not (self.sessions or self.commands or self.plans) and self.paid < moment

    def full(self, what: str, limit: int) -> QueueFull:
        """Count a refusal and return it; it tells the limit, not who else has how much."""
        self.refused[what] = self.refused.get(what, 0) + 1
        return QueueFull(
            f"this {self.owner} already has {limit} {what}, its quota",
            remedy=f"End {what} that you no longer need, or ask the operator for a larger quota.",
            details={"quota": self.owner, "what": what, "limit": limit},
        )

    def usage(self) -> dict[str, Any]:
        """Describe what is limited: how much is used, and the limit."""
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


_UNLIMITED: QuotaUsage[Any] = QuotaUsage("principal", "", NONE)


class TokenBucket(Generic[S]):
    """What every request of one session passes."""

    __slots__ = ("accounts", "choked", "first", "second")

    def __init__(self, accounts: tuple[QuotaUsage[S], ...]) -> None:
        self.accounts = accounts
        self.first = accounts[0]
        self.second = accounts[1] if len(accounts) > 1 else _UNLIMITED
        self.choked: QuotaUsage[S] | None = None
        """Whose quota of waiting bytes this session's untaken replies exceed."""

    def take(self, moment: float) -> bool:
        """Pay for a request at `moment` (`perf_counter`), or pay nothing and return False."""
        first, second = self.first, self.second
        paid = first.paid
        if paid < moment:  # noqa: PLR1730 - a call less for each request
            paid = moment
        other = second.paid
        if other < moment:  # noqa: PLR1730
            other = moment
        if paid > moment + first.slack or other > moment + second.slack or self.choked is not None:
            return False
        first.paid = paid + first.interval
        second.paid = other + second.interval
        return True

    def allows(self, moment: float) -> bool:
        """Tell whether `take` would pay for a request."""
        first, second = self.first, self.second
        return (
            first.paid <= moment + first.slack
            and second.paid <= moment + second.slack
            and self.choked is None
        )

    def refusal(self, moment: float) -> RcpError:
        """Count and return why `take` took nothing."""
        if (choked := self.choked) is not None:
            error = choked.full("queue_bytes", choked.quota.queue_bytes or 0)
            error.remedy = "Read the messages that are waiting before you send more requests."
            error.retry_after = SWEEP
            return error
        account = max(self.first, self.second, key=lambda a: a.paid - a.slack)
        account.refused["requests"] = account.refused.get("requests", 0) + 1
        return RateLimited(
            f"this {account.owner} may send {account.quota.requests:g} requests per second",
            retry_after=round(max(account.paid - account.slack - moment, 0.0) + 0.0005, 3),
            details={
                "quota": account.owner,
                "what": "requests",
                "limit": account.quota.requests,
                "burst": account.quota.burst or max(1, round(account.quota.requests or 1)),
            },
        )
