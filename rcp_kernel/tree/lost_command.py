"""A command that a robot lost with its link, or with an earlier gateway, and may still obey."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BEFORE", "LossRecord", "LostCommand"]

BEFORE = -1
"""Number of stops before a command of an earlier gateway began."""


@dataclass(frozen=True, eq=False, slots=True)
class LostCommand:
    """A command whose robot may still obey it."""

    path: str
    began: int
    """Number of stops before it began."""


class LossRecord:
    """What a robot has lost, until a halt reaches it, its loss policy is applied, or a new command begins."""

    __slots__ = ("_halted", "command")

    def __init__(self) -> None:
        self.command: LostCommand | None = None
        """The latest lost command; its loss policy has not been applied yet."""
        self._halted = BEFORE
        """Number of stops before the newest halt that has reached the robot."""

    def note(self, path: str, began: int) -> bool:
        """Record that a command was lost which began after so many stops.

        Return False, and do nothing, if a halt has reached the robot since.
        """
        if began < self._halted:
            return False
        self.command = LostCommand(path, began)
        return True

    def note_halt(self, number: int) -> None:
        """Record that a halt, sent after so many stops, has reached it: what began before is over."""
        self._halted = max(self._halted, number)
        if self.command is not None and self.command.began < self._halted:
            self.command = None
