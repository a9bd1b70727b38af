"""Rights to see and to cancel commands."""

from __future__ import annotations

from collections.abc import Iterator

from rcp_kernel.access.acl import reach
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.contract.paths import EVERYTHING
from rcp_kernel.errors import UnknownPath
from rcp_kernel.model import Operation
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session
from rcp_requests.journal import CommandJournal

__all__ = ["CommandAccess", "is_own"]

_READ = Operation.READ


class CommandAccess:
    """Finds the commands that a session may know of."""

    def __init__(
        self, journal: CommandJournal, visibility: Visibility, identities: Identities
    ) -> None:
        self._journal = journal
        self._visibility = visibility
        self._identities = identities

    def sees(self, session: Session, command: Command) -> bool:
        """Tell whether a session may know of a command: of all that it is about."""
        rights, visibility = session.rights, self._visibility
        if not rights.mask(command.path):
            return False
        if is_own(session, command):  # also what is told of it already, unless the rights have gone
            return visibility.sees_all(rights, (p for p in command.touches if p != EVERYTHING))
        if command.is_system:
            tenants = self._identities.tenants_of(session.principal)
            # Of what it has read in the name of who sent it, the value is told.
            if command.tenant not in tenants or not visibility.sees_all(
                rights, command.touches, _READ
            ):
                return False
        return not visibility.mentions_hidden(rights, command.tenant, command.names)

    def visible(self, session: Session) -> list[Command]:
        """List the commands that a session may see, newest first."""
        return [command for command in self.judged(session) if command is not None]

    def judged(self, session: Session, path: str | None = None) -> Iterator[Command | None]:
        """Iterate over all commands, or those on a path, newest first.

        None stands for a command that is hidden from the session or on another path.
        """
        for command in self._journal.every():
            wanted = path is None or command.path == path
            yield command if wanted and self.sees(session, command) else None

    def visited(self, session: Session) -> Iterator[Command | None]:
        """Iterate over all commands, newest first; None stands for a hidden one."""
        known = sorted(self._journal.every(), key=lambda command: command.order_key, reverse=True)
        return (command if self.sees(session, command) else None for command in known)

    def find(self, session: Session, id_: str) -> Command:
        """Return a command that the session may see.

        :raises UnknownPath: there is none, or not for this principal.
        """
        command = self._journal.find(id_)
        mask = 0 if command is None else reach(session.rights.mask(command.path))
        if command is None or not (mask & Operation.EXECUTE and self.sees(session, command)):
            raise _no_command(id_)
        return command

    def to_cancel(self, session: Session, id_: str) -> Command:
        """Return a command that the session may see, or has sent: that it may stop in any case.

        :raises UnknownPath: there is none, or not for this principal.
        """
        command = self._journal.find(id_)
        if command is not None and is_own(session, command) and session.rights.mask(command.path):
            return command
        return self.find(session, id_)


def is_own(session: Session, command: Command) -> bool:
    """Tell whether a command is one of the session's principal."""
    principal = session.principal
    return (command.principal, command.proof) == principal.identity


def _no_command(id_: str) -> UnknownPath:
    return UnknownPath(f"unknown command '{id_[:64]}'", remedy="List `commands`.")
