"""The values that may be in force on a path: the last confirmed one, and unconfirmed ones.

A write in progress may reach the robot at any moment, and an unanswered write may have reached it.
Rate limits must hold for each of these values.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

__all__ = ["CommandedValues", "Force"]

_MOST = 16  # unconfirmed values; older ones are dropped


class Force(NamedTuple):
    """A value that may be in force."""

    value: Any
    since: float
    """Time of sending, by `Clock.monotonic`."""


class CommandedValues:
    """The values that one path may have in force, oldest first."""

    __slots__ = ("_now", "possible")

    def __init__(self, now: Callable[[], float]) -> None:
        """Hold nothing; `now` is `Clock.monotonic`."""
        self._now = now
        self.possible: tuple[Force, ...] = ()

    def attempt(self, value: Any, since: float | None = None) -> None:
        """Record that a value is being sent, by default now."""
        if not self.possible or self.possible[-1].value is not value:  # a stop is sent repeatedly
            self.possible = (*self.possible, Force(value, self._now() if since is None else since))[
                -_MOST:
            ]

    def settle(self, value: Any, actual: Any) -> None:
        """Record that the robot accepted a value as `actual`; earlier values are dropped."""
        at = self._find(value)
        since = self._now() if at is None else self.possible[at].since
        later = self.possible if at is None else self.possible[at + 1 :]
        self.possible = (Force(actual, since), *later)[-_MOST:]

    def withdraw(self, value: Any) -> None:
        """Record that the robot rejected a value and continues as before."""
        at = self._find(value)
        if at is not None:
            self.possible = self.possible[:at] + self.possible[at + 1 :]

    def rest(self, safe: Any) -> None:
        """Record that the robot was brought to rest; without a safe value, nothing is known."""
        self.possible = () if safe is None else (Force(safe, self._now()),)

    def _find(self, value: Any) -> int | None:
        return next((i for i, force in enumerate(self.possible) if force.value is value), None)
