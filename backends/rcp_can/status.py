"""What a drive said last, and when: each signal has an age of its own."""

from __future__ import annotations

import time
from collections import Counter, deque
from typing import NamedTuple

__all__ = ["Fault", "Status"]

_WINDOW = 0.1  # s over which a velocity is taken from positions
_SHORTEST = 0.04  # s: positions nearer together than this make no velocity


class Fault(NamedTuple):
    """A fault that stands."""

    name: str
    text: str
    code: int | None = None


class Status:
    """What the drive said last; rad, rad/s and N·m at its own shaft, None where it says nothing.

    Setting `position`, `velocity` or `enabled` notes the time: a profile sets them from a frame
    that carries them, and from nothing else.
    """

    def __init__(self) -> None:
        self.at: dict[str, float] = {}
        """When each signal was told last, by the monotonic clock."""
        self.counts: Counter[str] = Counter()
        """How often each signal was told."""
        self._position: float | None = None
        self._velocity: float | None = None
        self._enabled: bool | None = None
        self._past: deque[tuple[float, float]] = deque()
        self.torque: float | None = None
        self.current: float | None = None
        self.drive_temperature: float | None = None
        self.motor_temperature: float | None = None
        self.voltage: float | None = None
        self.holding: bool | None = None
        """Whether it holds torque although it is not enabled; None: `enabled` says it all."""
        self.faults: tuple[Fault, ...] = ()
        self.reached: bool | None = None
        self.homed: bool | None = None
        self.beat = 0.0
        """When it sent its last heartbeat, by the monotonic clock."""
        self.moved = 0
        """Counts news of the motion."""
        self.reports = 0
        """Counts news of anything else."""
        self.resets = 0
        """Counts boots that were seen."""
        self.twins = 0
        """Counts signs that two drives answer to one id."""

    def _note(self, signal: str) -> float:
        now = time.monotonic()
        self.at[signal] = now
        self.counts[signal] += 1
        return now

    @property
    def position(self) -> float | None:
        """Where its shaft is."""
        return self._position

    @position.setter
    def position(self, value: float | None) -> None:
        self._position = value
        if value is None:
            self.at.pop("position", None)
            return
        now = self._note("position")
        if self._velocity is None:  # this drive tells none: positions must do
            past = self._past
            past.append((now, value))
            while now - past[0][0] > 2 * _WINDOW:
                past.popleft()
            if now - past[0][0] >= _SHORTEST:
                self._note("velocity")

    @property
    def velocity(self) -> float | None:
        """How fast it turns; from its positions where it tells no velocity."""
        if self._velocity is not None or len(self._past) < 2:
            return self._velocity
        last, here = self._past[-1]
        first, there = next(
            (then for then in reversed(self._past) if last - then[0] >= _WINDOW), self._past[0]
        )
        return (here - there) / (last - first) if last - first >= _SHORTEST else None

    @velocity.setter
    def velocity(self, value: float | None) -> None:
        self._velocity = value
        self._past.clear()
        if value is None:
            self.at.pop("velocity", None)
        else:
            self._note("velocity")

    @property
    def enabled(self) -> bool | None:
        """Whether it takes set-points, by its own word; None before it has said anything."""
        return self._enabled

    @enabled.setter
    def enabled(self, value: bool | None) -> None:
        self._enabled = value
        if value is None:
            self.at.pop("enabled", None)
        else:
            self._note("enabled")

    @property
    def energised(self) -> bool | None:
        """Whether it gives torque, or holds it after a stop."""
        return self._enabled if self.holding is None else self.holding
