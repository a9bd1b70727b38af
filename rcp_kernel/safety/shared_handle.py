"""A timer or task that several actuators share, and that each can leave by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from rcp_kernel.tree.entry import Entry

__all__ = ["Cancellable", "Shared"]


class Cancellable(Protocol):
    """A timer, a task, or a part of one."""

    def cancel(self) -> object:
        """Cancel it."""
        ...


class Shared:
    """The actuators that still share something."""

    __slots__ = ("_members",)

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._members = {entry.path: entry for entry in entries}

    @property
    def members(self) -> list[Entry]:
        """The actuators whose handles were not cancelled."""
        return list(self._members.values())

    def take(self) -> list[Entry]:
        """Return the members and remove them all."""
        members = self.members
        self._members.clear()
        return members

    def parts(self, on_cancel: Callable[[list[Entry]], None]) -> dict[str, Cancellable]:
        """Return a handle for each; `on_cancel` gets the other members when one is cancelled."""
        return {path: _Part(self, path, on_cancel) for path in self._members}

    def leave(self, path: str, on_cancel: Callable[[list[Entry]], None]) -> None:
        """Remove a member."""
        if self._members.pop(path, None) is not None:
            on_cancel(self.members)


class _Part:
    """The part of one of them."""

    __slots__ = ("_on_cancel", "_path", "_shared")

    def __init__(self, shared: Shared, path: str, on_cancel: Callable[[list[Entry]], None]) -> None:
        self._shared = shared
        self._path = path
        self._on_cancel = on_cancel

    def cancel(self) -> None:
        """Leave the others."""
        self._shared.leave(self._path, self._on_cancel)
