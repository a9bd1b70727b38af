"""Gateway actions waiting to be checked: a cancel or an e-stop reaches them too."""

from __future__ import annotations

import time
from weakref import WeakSet

from rcp_kernel.errors import QueueFull
from rcp_kernel.sessions.command import Command, command_id
from rcp_kernel.sessions.session import Session
from rcp_requests.command_access import CommandAccess, is_own
from rcp_requests.commands import Commands

__all__ = ["WaitingCommand", "WaitingCommands"]

_ASKING = 16  # other principals that may request a cancel while it waits


class WaitingCommand:
    """A gateway action from its request until it is refused or runs."""

    def __init__(self, session: Session, since: float | None) -> None:
        self.session = session
        self.id = command_id()
        """Id of the command that it becomes."""
        self.since = time.monotonic() if since is None else since
        """When it arrived, compared with `RobotUnit.stopped`."""
        self.cancelled = False
        """Whether its own principal has requested a cancel."""
        self.asking: dict[object, Session] = {}
        """Other principals that have, by identity and rights."""


class WaitingCommands:
    """The gateway actions of one resource that wait; dropped when unreferenced."""

    def __init__(self, access: CommandAccess, commands: Commands) -> None:
        self._access = access
        self._commands = commands
        self._known: WeakSet[WaitingCommand] = WeakSet()

    def enter(self, session: Session, since: float | None = None) -> WaitingCommand:
        """Record a command that waits from now on, or since a monotonic time."""
        waiting = WaitingCommand(session, since)
        self._known.add(waiting)
        return waiting

    def leave(self, waiting: WaitingCommand) -> None:
        """Remove a command that has been refused or has started."""
        self._known.discard(waiting)

    def own(self, session: Session) -> list[WaitingCommand]:
        """List those of a session's principal."""
        identity = session.principal.identity
        return [one for one in self._known if one.session.principal.identity == identity]

    def cancel(self, session: Session, *, others: bool) -> list[str]:
        """Cancel those visible to a session; return the ids of its principal's.

        Those of other principals (skipped without `others`) are unknown before they are checked.

        :raises QueueFull: too many principals have requested a cancel of one that waits.
        """
        own = self.own(session)
        for waiting in own:
            waiting.cancelled = True
        if others:
            owner = session.principal.identity, session.tenant, session.rights
            for waiting in set(self._known).difference(own):
                if owner not in waiting.asking and len(waiting.asking) >= _ASKING:
                    raise QueueFull(
                        "too many clients have cancelled what waits for its turn here",
                        remedy="Cancel it by its id as soon as it runs.",
                        retry_after=1.0,
                    )
                waiting.asking[owner] = session
        return [waiting.id for waiting in own]

    def settle(self, waiting: WaitingCommand, command: Command) -> None:
        """Cancel a command that has just started, if that was requested."""
        self.leave(waiting)
        asking = [waiting.session] if waiting.cancelled else []
        for session in (*asking, *waiting.asking.values()):
            if is_own(session, command) or self._access.sees(session, command):
                self._commands.cancel(command, f"requested by {session.principal.name}")
                return
