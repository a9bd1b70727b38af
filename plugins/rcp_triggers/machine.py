"""The state of one trigger on one robot: pure, and told the time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Machine", "Outcome", "State", "Timing"]

State = Literal["clear", "pending", "active"]
Outcome = Literal["fire", "suppress", "clear"]


@dataclass(frozen=True, slots=True)
class Timing:
    """When a condition fires; all times in s."""

    held: float = 0.0
    """How long the condition has to hold before it fires."""
    edge: bool = False
    """Whether it fires only if the condition was seen false before."""
    repeat: float | None = None
    """Time between firings while it stays active; None: it fires once."""
    cool_down: float = 0.0
    """Least time between two firings."""
    hysteresis: bool = False
    """Whether a condition of its own clears it."""


class Machine:
    """Goes from `clear` by `pending` to `active`, where it has fired, and back.

    An unknown condition neither fires nor clears: what was pending has to hold anew, and what is
    active stays so.
    """

    __slots__ = ("_armed", "_known", "fired", "since", "state", "timing")

    def __init__(self, timing: Timing) -> None:
        self.timing = timing
        self.state: State = "clear"
        self.since: float | None = None
        """When it became pending."""
        self.fired: float | None = None
        """When it fired last."""
        self._armed = False
        """Whether the condition was false since it fired last."""
        self._known = False
        """Whether it was known in the last step."""

    def resume(self, fired: float, *, active: bool) -> None:
        """Go on where an earlier run left off."""
        self.fired = fired
        if active:
            self.state = "active"

    def step(self, now: float, *, when: bool | None, clear: bool | None = None) -> Outcome | None:
        """Take the conditions as they are; return what comes of it.

        `suppress` is a firing that the cool-down swallowed: only of an edge, as anything else waits
        for its end.
        """
        self._known = when is not None
        if self.state == "active":
            return self._active(now, when=when, clear=clear)
        if when is None:
            self.state = "clear"
            return None
        if not when:
            self.state, self._armed = "clear", True
            return None
        if self.state == "clear":
            if self.timing.edge and not self._armed:
                return None
            self.state, self.since = "pending", now
        return self._pending(now)

    def _pending(self, now: float) -> Outcome | None:
        assert self.since is not None
        if now < self.since + self.timing.held:
            return None
        if now < self._rested():
            if not self.timing.edge:
                return None
            self.state, self._armed = "active", False
            return "suppress"
        return self._fire(now)

    def _active(self, now: float, *, when: bool | None, clear: bool | None) -> Outcome | None:
        over = clear is True and when is not True if self.timing.hysteresis else when is False
        if over:
            self.state, self._armed = "clear", True
            return "clear"
        due = self._repeated()
        if due is not None and now >= due and when is not None:
            return self._fire(now)
        return None

    def _fire(self, now: float) -> Outcome:
        self.state, self._armed, self.fired = "active", False, now
        return "fire"

    def _rested(self) -> float:
        return float("-inf") if self.fired is None else self.fired + self.timing.cool_down

    def _repeated(self) -> float | None:
        if self.timing.repeat is None or self.fired is None:
            return None
        return self.fired + max(self.timing.repeat, self.timing.cool_down)

    @property
    def due(self) -> float | None:
        """When the passing of time alone may change something."""
        if self.state == "pending":
            assert self.since is not None
            held = self.since + self.timing.held
            return held if self.timing.edge else max(held, self._rested())
        # What is unknown does not fire: time alone changes nothing until it is known again.
        return self._repeated() if self.state == "active" and self._known else None
