"""What becomes of commands: for features that need to know what a robot was told last."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from rcp_kernel.features.guard import Call
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.tree.entry import Entry

__all__ = ["CommandEvents", "CommandObserver"]


class CommandObserver(Protocol):
    """Hears of every write and execute on a robot, and of what brings it to rest.

    Called on the event loop: it takes note, and neither blocks nor awaits. It cannot refuse
    anything; an exception is logged and changes nothing.
    """

    def sent(self, call: Call) -> None:
        """All guards have let a command pass; it goes to its robot now."""
        ...

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """The robot took a written value, as `actual`."""
        ...

    def refused(self, entry: Entry, value: Any) -> None:
        """A written value was not taken: the robot goes on as before."""
        ...

    def stopping(self, entry: Entry, safe: Any) -> None:
        """The gateway sends an actuator its safe value; repeated until the robot takes it."""
        ...

    def rested(self, entry: Entry, safe: Any) -> None:
        """The safe value is in force, or the robot is brought to rest as a whole.

        `safe` is None for what has no safe value.
        """
        ...


class CommandEvents:
    """Passes on what becomes of commands; nothing depends on whoever hears it."""

    def __init__(self) -> None:
        self._observers: tuple[tuple[CommandObserver, FeatureHealth], ...] = ()

    def configure(self, observers: Iterable[tuple[CommandObserver, FeatureHealth]]) -> None:
        """Tell these from now on."""
        self._observers = tuple(observers)

    def sent(self, call: Call) -> None:
        """Pass it on."""
        for observer, health in self._observers:
            try:
                observer.sent(call)
            except Exception as error:
                health.failed("observer", error, path=call.entry.path)

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Pass it on."""
        for observer, health in self._observers:
            try:
                observer.took(entry, value, actual)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def refused(self, entry: Entry, value: Any) -> None:
        """Pass it on."""
        for observer, health in self._observers:
            try:
                observer.refused(entry, value)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def stopping(self, entry: Entry, safe: Any) -> None:
        """Pass it on."""
        for observer, health in self._observers:
            try:
                observer.stopping(entry, safe)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def rested(self, entry: Entry, safe: Any) -> None:
        """Pass it on."""
        for observer, health in self._observers:
            try:
                observer.rested(entry, safe)
            except Exception as error:
                health.failed("observer", error, path=entry.path)
