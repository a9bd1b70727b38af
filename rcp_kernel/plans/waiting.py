"""Plans that wait for their turn to be checked: a cancel or an e-stop meanwhile reaches them too."""

from __future__ import annotations

import secrets
import time
from weakref import WeakSet

from rcp_kernel.requests.command_access import CommandAccess, is_own
from rcp_kernel.requests.commands import Commands
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session

__all__ = ["WaitingPlan", "WaitingPlans"]


class WaitingPlan:
    """A plan from its request until it is refused or runs."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.command = "cmd-" + secrets.token_hex(8)
        """The id of the command that it becomes."""
        self.since = time.monotonic()
        self.cancelling: list[Session] = []
        """Who asked for all plans to be cancelled while it waited."""


class WaitingPlans:
    """All of them; one that nothing refers to any more waits no longer."""

    def __init__(self, access: CommandAccess, commands: Commands) -> None:
        self._access = access
        self._commands = commands
        self._known: WeakSet[WaitingPlan] = WeakSet()

    def enter(self, session: Session) -> WaitingPlan:
        """Take notice of a plan that waits from now on."""
        waiting = WaitingPlan(session)
        self._known.add(waiting)
        return waiting

    def leave(self, waiting: WaitingPlan) -> None:
        """Take notice that a plan has been refused, or runs."""
        self._known.discard(waiting)

    def own(self, session: Session) -> list[WaitingPlan]:
        """List the plans of a session's principal."""
        identity = session.principal.identity
        return [one for one in self._known if one.session.principal.identity == identity]

    def cancel(self, session: Session, *, others: bool) -> list[str]:
        """Have the plans cancelled that a session may see; return the ids of its principal's.

        What is in those of others (left out without `others`) is not known before they are checked.
        """
        own = self.own(session)
        for waiting in list(self._known) if others else own:
            waiting.cancelling.append(session)
        return [waiting.command for waiting in own]

    def settle(self, waiting: WaitingPlan, command: Command) -> None:
        """Cancel a plan that has begun to run and has done nothing yet, if that was asked for."""
        self.leave(waiting)
        for session in waiting.cancelling:
            if is_own(session, command) or self._access.sees(session, command):
                self._commands.cancel(command, f"requested by {session.principal.name}")
                return
