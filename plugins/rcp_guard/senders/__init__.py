"""The senders of stops: opened in advance, by the names that plans use."""

from __future__ import annotations

import importlib
from typing import Any, Protocol

__all__ = ["MissingLibraryError", "Sender", "open_sender"]

_MODULES = {"can": "can_bus", "ros2": "ros2", "udp": "udp"}


class MissingLibraryError(Exception):
    """A required library is missing, or the sender cannot work as configured."""


class Sender(Protocol):
    """The connection of one plan to its robot; used by one thread."""

    @property
    def unusable(self) -> str:
        """The parts of the plan that this installation cannot send."""
        ...

    def send(self) -> None:
        """Send the stop without waiting for the robot.

        :raises Exception: it could not be sent; after repeated failures the sender is reopened.
        """
        ...

    def lacks(self) -> str:
        """Return which receivers are missing, as far as this can be known; empty if none."""
        ...

    def close(self) -> None:
        """Close what was opened."""
        ...


def open_sender(name: str, data: dict[str, Any]) -> Sender:
    """Open a sender.

    :raises MissingLibraryError: it requires a change of the installation or the plan.
    :raises Exception: it cannot be opened now.
    """
    module = _MODULES.get(name)
    if module is None:
        known = ", ".join(_MODULES)
        raise MissingLibraryError(f"unknown sender '{name}'; available: {known}")
    return importlib.import_module(f"{__name__}.{module}").open_sender(data)
