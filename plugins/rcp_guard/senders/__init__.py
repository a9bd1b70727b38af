"""What tells a robot to stop: opened before it is needed, by the names that plans use."""

from __future__ import annotations

import importlib
from typing import Any, Protocol

__all__ = ["MissingLibraryError", "Sender", "open_sender"]

_MODULES = {"can": "can_bus", "ros2": "ros2", "udp": "udp"}


class MissingLibraryError(Exception):
    """What a sender needs is not installed, or it cannot work as configured at all."""


class Sender(Protocol):
    """One plan's way to its robot; used by one thread."""

    @property
    def unusable(self) -> str:
        """What of the plan cannot be sent by this installation, while the rest can."""
        ...

    def send(self) -> None:
        """Tell the robot to stop, without waiting for it.

        :raises Exception: it could not be sent; the sender is opened anew if that goes on.
        """
        ...

    def lacks(self) -> str:
        """Say who is not there to hear it, or nothing if all are, as far as that can be known."""
        ...

    def close(self) -> None:
        """Let go of what was opened."""
        ...


def open_sender(name: str, data: dict[str, Any]) -> Sender:
    """Open a sender.

    :raises MissingLibraryError: it will not work without a change of installation or plan.
    :raises Exception: it cannot be opened now.
    """
    module = _MODULES.get(name)
    if module is None:
        known = ", ".join(_MODULES)
        raise MissingLibraryError(f"unknown sender '{name}'; available: {known}")
    return importlib.import_module(f"{__name__}.{module}").open_sender(data)
