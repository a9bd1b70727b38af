"""What values a path may have in force: the one last written, and those whose fate is not known.

A write under way may reach the robot at any moment, and one that was never answered may have. A
rate of change has to hold whichever of them it was.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

__all__ = ["CommandedValues", "Force", "clock"]

_MOST = 16  # values of unknown fate; older ones are forgotten
clock = time.monotonic


class Force(NamedTuple):
    """A value that may be in force."""

    value: Any
    since: float
    """When it was sent, by `clock`."""


class CommandedValues:
    """The values that one path may have in force, oldest first."""

    __slots__ = ("held",)

    def __init__(self) -> None:
        self.held: tuple[Force, ...] = ()

    def attempt(self, value: Any, since: float | None = None) -> None:
        """Note that a value is on its way to the robot, by default since now."""
        if not self.held or self.held[-1].value is not value:  # a stop is sent again and again
            self.held = (*self.held, Force(value, clock() if since is None else since))[-_MOST:]

    def settle(self, value: Any, actual: Any) -> None:
        """Note that the robot took a value, as `actual`: what was sent before it is past."""
        at = self._find(value)
        since = clock() if at is None else self.held[at].since
        later = self.held if at is None else self.held[at + 1 :]
        self.held = (Force(actual, since), *later)[-_MOST:]

    def withdraw(self, value: Any) -> None:
        """Note that the robot did not take a value and goes on as before."""
        at = self._find(value)
        if at is not None:
            self.held = self.held[:at] + self.held[at + 1 :]

    def rest(self, safe: Any) -> None:
        """Note that the robot was brought to rest; without a safe value nothing is known."""
        self.held = () if safe is None else (Force(safe, clock()),)

    def _find(self, value: Any) -> int | None:
        return next((i for i, force in enumerate(self.held) if force.value is value), None)
