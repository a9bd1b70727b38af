"""Observers: features that follow the last command to a robot, and every stop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcp_kernel.features.guard import Call
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.tree.entry import Entry

__all__ = ["CommandEvents", "CommandObserver"]


class CommandObserver:
    """Receives every write and execute on a robot, and every stop.

    Called on the event loop: must neither block nor await. It cannot refuse anything; an exception
    is logged and changes nothing. Without an override, a method does nothing.
    """

    writes_only: bool = False
    """Whether `sent` is not called for executes; read at the start and after each reload."""

    def sent(self, call: Call) -> None:
        """A command has passed all guards and is being sent to its robot."""

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """The robot accepted a written value, as `actual`."""

    def refused(self, entry: Entry, value: Any) -> None:
        """The robot did not accept a written value, and continues as before."""

    def stopping(self, entry: Entry, safe: Any) -> None:
        """The gateway sends an actuator its safe value, repeatedly until the robot accepts it."""

    def rested(self, entry: Entry, safe: Any) -> None:
        """The safe value is in force, or the whole robot is at rest.

        `safe` is None for an actuator without a safe value.
        """


class CommandEvents:
    """Passes command events to observers, whose errors change nothing."""

    def __init__(self) -> None:
        self._observers: tuple[tuple[CommandObserver, FeatureHealth], ...] = ()
        self.of_executes: tuple[tuple[CommandObserver, FeatureHealth], ...] = ()
        """The observers that hear of executes."""

    def configure(self, observers: Iterable[tuple[CommandObserver, FeatureHealth]]) -> None:
        """Set the observers."""
        self._observers = tuple(observers)
        self.of_executes = tuple(one for one in self._observers if not one[0].writes_only)

    def sent(self, call: Call) -> None:
        """Notify the observers: of an execute, those in `of_executes`."""
        executes = call.request.type == "execute"
        for observer, health in self.of_executes if executes else self._observers:
            try:
                observer.sent(call)
            except Exception as error:
                health.failed("observer", error, path=call.entry.path)

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Notify the observers."""
        for observer, health in self._observers:
            try:
                observer.took(entry, value, actual)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def refused(self, entry: Entry, value: Any) -> None:
        """Notify the observers."""
        for observer, health in self._observers:
            try:
                observer.refused(entry, value)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def stopping(self, entry: Entry, safe: Any) -> None:
        """Notify the observers."""
        for observer, health in self._observers:
            try:
                observer.stopping(entry, safe)
            except Exception as error:
                health.failed("observer", error, path=entry.path)

    def rested(self, entry: Entry, safe: Any) -> None:
        """Notify the observers."""
        for observer, health in self._observers:
            try:
                observer.rested(entry, safe)
            except Exception as error:
                health.failed("observer", error, path=entry.path)
