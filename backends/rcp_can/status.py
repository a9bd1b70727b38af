"""The last reports of a drive, each signal with its own age."""

from __future__ import annotations

import time
from collections import Counter, deque
from typing import NamedTuple

__all__ = ["Fault", "Status"]

_WINDOW = 0.1  # s over which a velocity is derived from positions
_SHORTEST = 0.04  # s: positions closer together than this give no velocity


class Fault(NamedTuple):
    """An active fault."""

    name: str
    text: str
    code: int | None = None


class Status:
    """The last reports of a drive; rad, rad/s and N·m at its own shaft, None if it reports nothing.

    Setting `position`, `velocity` or `enabled` records the time: a profile sets them only from a
    frame that carries them.
    """

    def __init__(self) -> None:
        self.at: dict[str, float] = {}
        """When each signal was last reported, monotonic time in s."""
        self.frame_at: float | None = None
        """When the frame that is being decoded was received, monotonic time in s; None: now."""
        self.received_at: dict[str, float] = {}
        """When the frames of the last reports were received, however late they were decoded."""
        self.counts: Counter[str] = Counter()
        """How often each signal was reported."""
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
        """Whether it holds torque although it is not enabled; None: `enabled` tells."""
        self.faults: tuple[Fault, ...] = ()
        self.reached: bool | None = None
        self.homed: bool | None = None
        self.beat = float("-inf")
        """When it sent its last heartbeat, monotonic time in s."""
        self.moved = 0
        """Counts reports of motion."""
        self.reports = 0
        """Counts all other reports."""
        self.resets = 0
        """Counts observed boots, and other losses of the configuration."""
        self.reset = "the drive rebooted"
        """What the last of them was seen to be."""
        self.twins = 0
        """Counts signs that two drives have the same id."""

    def _note(self, signal: str) -> float:
        now = time.monotonic()
        self.at[signal] = now
        self.counts[signal] += 1
        received = self.received_at[signal] = now if self.frame_at is None else self.frame_at
        return received

    @property
    def position(self) -> float | None:
        """Position of its shaft, rad."""
        return self._position

    @position.setter
    def position(self, value: float | None) -> None:
        self._position = value
        if value is None:
            self.at.pop("position", None)
            return
        now = self._note("position")
        if self._velocity is None:  # this drive reports no velocity: derive it from positions
            past = self._past
            past.append((now, value))
            while now - past[0][0] > 2 * _WINDOW:
                past.popleft()
            if now - past[0][0] >= _SHORTEST:
                self._note("velocity")

    @property
    def velocity(self) -> float | None:
        """Velocity of its shaft, rad/s; derived from positions if the drive reports none."""
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
        """Whether it accepts set-points, as it reports; None before the first report."""
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
        """Whether it applies torque, or holds it after a stop."""
        return self._enabled if self.holding is None else self.holding
