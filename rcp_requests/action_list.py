"""The value of an action's resource: its commands, as each reader may see them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from weakref import WeakKeyDictionary

from rcp_kernel.features.action import Action
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import ANY, Encoding, to_plain
from rcp_kernel.wire import Body
from rcp_requests.command_access import CommandAccess

__all__ = ["ActionList"]

_LISTED = 50  # commands
_SHORT = 16_384  # bytes of a command that are kept as they are written


class ActionList:
    """The commands of one action that run or ran lately."""

    def __init__(self, path: str, action: Action, access: CommandAccess) -> None:
        self._path = path
        self._action = action
        self._access = access
        self._ended: WeakKeyDictionary[Command, _Shown] = WeakKeyDictionary()

    def view(self, session: Session) -> Iterator[Body | None]:
        """List the visible commands, newest first; None stands for any other command."""
        left = _LISTED
        for command in self._access.judged(session, self._path):
            yield None if command is None else self._shown(command)
            left -= command is not None
            if not left:
                return

    def _shown(self, command: Command) -> _Shown:
        if not command.final:
            return _Shown(self._action, command)
        shown = self._ended.get(command)
        if shown is None:
            shown = self._ended[command] = _Shown(self._action, command)
        return shown


class _Shown(Body):
    """A command as shown in the list; finished short ones are encoded once."""

    __slots__ = ("__weakref__", "_action", "_command", "_written")

    def __init__(self, action: Action, command: Command) -> None:
        self._action = action
        self._command = command
        self._written: dict[Encoding, bytes] = {}

    @property
    def value(self) -> Any:
        """The command as plain data."""
        return to_plain(self._action.show(self._command))

    def encoded(self, encoding: Encoding) -> bytes:
        """Return it as bytes of the encoding."""
        data = self._written.get(encoding)
        if data is None:
            data = ANY.encode(self._action.show(self._command), encoding)
            if self._command.final and len(data) <= _SHORT:
                self._written[encoding] = data
        return data
