"""Quota checks of the requests, subscriptions and commands of one session."""

from __future__ import annotations

from collections.abc import Callable

from rcp_kernel.errors import RcpError
from rcp_quotas.config import NONE
from rcp_quotas.usage import QuotaUsage

__all__ = ["SWEEP", "TokenBucket"]

SWEEP = 0.25  # s between two checks of unread data
_PLANS = "/system/plans"
_UNLIMITED = QuotaUsage("principal", "", NONE)


class TokenBucket:
    """The quotas of one session: its principal's, its tenant's, or both."""

    __slots__ = ("choked", "first", "second", "usages")

    def __init__(self, usages: tuple[QuotaUsage, ...]) -> None:
        self.usages = usages
        self.first = usages[0]
        self.second = usages[1] if len(usages) > 1 else _UNLIMITED
        self.choked: QuotaUsage | None = None
        """The owner whose quota of unread bytes this session's clients exceed."""

    def take(self, moment: float) -> bool:
        """Charge a request at `moment` (`Clock.monotonic`); False if it is refused."""
        first, second = self.first, self.second
        paid = first.paid
        if paid < moment:  # noqa: PLR1730 - saves a call per request
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
        """Return whether `take` would charge a request."""
        first, second = self.first, self.second
        return (
            first.paid <= moment + first.slack
            and second.paid <= moment + second.slack
            and self.choked is None
        )

    def refusal(self, moment: float) -> RcpError:
        """Count and return the refusal of `take`."""
        if (choked := self.choked) is not None:
            error = choked.full("queue_bytes", choked.quota.queue_bytes or 0)
            error.remedy = "Read the messages that are waiting before you send more requests."
            error.retry_after = SWEEP
            return error
        return max(self.first, self.second, key=_ahead).too_fast(moment)

    def check_subscription(self) -> None:
        """Check the quota of subscriptions.

        :raises QueueFull: the tenant or principal has as many as allowed.
        """
        for usage in self.usages:
            limit = usage.quota.subscriptions
            if limit is not None and usage.subscriptions >= limit:
                raise usage.full("subscriptions", limit)

    def check_command(self, path: str) -> None:
        """Check the quotas of commands and plans; other paths of `/system` are exempt.

        :raises QueueFull: the tenant or principal has as many as allowed.
        """
        if path.startswith("/system/") and path != _PLANS:
            return
        for usage in self.usages:
            what, limit, held = "commands", usage.quota.commands, usage.commands
            if path == _PLANS:
                what, limit, held = "plans", usage.quota.plans, usage.plans
            if limit is not None and len(held) >= limit:
                raise usage.full(what, limit)

    def add_command(self, id_: str, path: str) -> Callable[[], None]:
        """Count a command until the returned function is called."""
        places = [usage.plans if path == _PLANS else usage.commands for usage in self.usages]
        for held in places:
            held.add(id_)

        def end() -> None:
            for held in places:
                held.discard(id_)

        return end


def _ahead(usage: QuotaUsage) -> float:
    return usage.paid - usage.slack
