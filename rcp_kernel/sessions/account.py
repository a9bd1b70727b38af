"""The account of one session: its requests, subscriptions and commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from rcp_kernel.errors import RcpError

__all__ = ["JointAccount", "SessionAccount", "joint", "passes"]


class SessionAccount(Protocol):
    """Counts the activity of one session, and may refuse it.

    Called on the event loop for each request: must neither block nor await. Requests that stop a
    robot or release something are never refused.
    """

    def take(self, moment: float) -> bool:
        """Count a request at `moment` (`Clock.monotonic`), or return False without counting.

        Called before the body is decoded. A request that stops a robot counts and passes in any
        case; e-stops, cancels and releases are not counted at all.
        """
        ...

    def allows(self, moment: float) -> bool:
        """Return whether `take` would count a request."""
        ...

    def refusal(self, moment: float) -> RcpError:
        """Return why `take` counted nothing."""
        ...

    def check_subscription(self) -> None:
        """Refuse another subscription.

        :raises RcpError: it is one too many.
        """
        ...

    def check_command(self, path: str) -> None:
        """Refuse another command on a path; also called for actions of the gateway, such as plans.

        For a robot's command it is called after the guards of control and motion and before the
        others (`Slot.POLICY`, `Slot.APPROVAL`); for an action of the gateway, before any guard.

        :raises RcpError: the limit is reached.
        """
        ...

    def add_command(self, id_: str, path: str) -> Callable[[], None]:
        """Count a command that starts; the returned function is called once when it ends."""
        ...


class JointAccount:
    """The accounts that several features have for one session; each may refuse."""

    __slots__ = ("_accounts",)

    def __init__(self, accounts: tuple[SessionAccount, ...]) -> None:
        self._accounts = accounts

    def take(self, moment: float) -> bool:
        """Count a request with all of them, or with none."""
        return self.allows(moment) and all(account.take(moment) for account in self._accounts)

    def allows(self, moment: float) -> bool:
        """Return whether all would count a request."""
        return all(account.allows(moment) for account in self._accounts)

    def refusal(self, moment: float) -> RcpError:
        """Return the refusal of the first that counts no request now."""
        refusing = (account for account in self._accounts if not account.allows(moment))
        return next(refusing, self._accounts[0]).refusal(moment)

    def check_subscription(self) -> None:
        """Refuse what any of them refuses."""
        for account in self._accounts:
            account.check_subscription()

    def check_command(self, path: str) -> None:
        """Refuse what any of them refuses."""
        for account in self._accounts:
            account.check_command(path)

    def add_command(self, id_: str, path: str) -> Callable[[], None]:
        """Count a command in all accounts."""
        ends = [account.add_command(id_, path) for account in self._accounts]

        def end() -> None:
            for ended in ends:
                ended()

        return end


def joint(accounts: Iterable[SessionAccount | None]) -> SessionAccount | None:
    """Return one account for those of several features; None where there is none."""
    found = tuple(account for account in accounts if account is not None)
    if len(found) > 1:
        return JointAccount(found)
    return found[0] if found else None


def passes(account: SessionAccount, moment: float) -> bool:
    """Count a request that can be answered at once; False: leave it to its handler.

    The handler asks the account again, and reports one that fails.
    """
    try:
        return account.take(moment)
    except Exception:
        return False
