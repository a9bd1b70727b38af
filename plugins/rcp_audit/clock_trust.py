"""How far the wall clock may be believed when it says that records are old, over all runs.

A clock that goes ahead by more than a day is believed after it has gone on like that for a day in
which the gateway runs, however many runs that takes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import structlog

from rcp_kernel.clock import Clock
from rcp_store.plugin_store import PluginStore

__all__ = ["ClockTrust"]

log = structlog.get_logger("rcp.audit")
_DAY = 86_400.0  # s
_MOST = 64  # levels
_KEY = "trust"


class ClockTrust:
    """Judges the wall clock by its level: how far it is ahead of the time that the gateway has run.

    A level stays as it is while the gateway runs, and changes when the clock is set and while the
    gateway is off. Each has the seconds that were spent at it or above. Time below counts back: a
    clock that was corrected is not believed at once when it goes wrong again, while a robot that
    starts in 1970 until it has a network loses only these minutes.
    """

    def __init__(
        self, clock: Clock, store: PluginStore, keep_days: Callable[[], float | None]
    ) -> None:
        """`keep_days` is how long records are kept: one that is kept for less waits for less."""
        self._clock = clock
        self._store = store
        self._keep_days = keep_days
        self._seen = clock.monotonic()
        self._run = 0.0
        """Seconds that the gateway has run, in all."""
        self._levels: list[tuple[float, float]] = []
        """Levels with the seconds spent at each, lowest first."""

    def load(self, last: int | None) -> None:
        """Continue from the earlier runs; `last` is the time of their last record, ns.

        It counts where they have stored nothing.
        """
        self._seen = self._clock.monotonic()
        try:
            kept: dict[str, Any] = self._store.load().get(_KEY, {})
            self._run = float(kept.get("run", 0.0))
            self._levels = [(float(level), float(spent)) for level, spent in kept.get("levels", ())]
        except (TypeError, ValueError, AttributeError):
            self._run, self._levels = 0.0, []
        if not self._levels and last is not None:
            self._levels = [(last / 1e9 - self._run, _DAY)]
        self.look()

    def look(self) -> int:
        """Count the time since the last look; return what time it is at least, for deletions, ns."""
        moment, wall = self._clock.monotonic(), self._clock.now()
        ran, self._seen = moment - self._seen, moment
        self._run += ran
        level = wall / 1e9 - self._run
        self._count(level, ran)
        self._add(level, ran)
        self._store.put(_KEY, {"run": self._run, "levels": self._levels})
        return wall - max(0, int((level - self._believed(level)) * 1e9))

    def _count(self, now: float, ran: float) -> None:
        counted = [
            (level, min(_DAY, spent + ran) if level - now <= _DAY else spent - ran)
            for level, spent in self._levels
        ]
        self._levels = [(level, spent) for level, spent in counted if spent >= 0]
        # What is below the highest one that is believed tells nothing more.
        while len(self._levels) > 1 and self._levels[1][1] >= _DAY:
            del self._levels[0]

    def _add(self, now: float, ran: float) -> None:
        """Note the level of the clock, unless it is about that of another."""
        above = [(level, spent) for level, spent in self._levels if level > now]
        below = self._levels[: len(self._levels) - len(above)]
        if above and above[0][0] - now <= _DAY:
            return
        if not self._levels:
            self._levels = [(now, _DAY)]
        elif below and now - below[-1][0] <= _DAY:
            if below[-1][1] >= _DAY:  # small steps are believed
                self._levels[len(below) - 1] = now, _DAY
        elif len(self._levels) < _MOST:
            spent = min(_DAY, above[0][1] + ran) if above else 0.0
            self._levels = [*below, (now, spent), *above]
            ahead = now - self._believed(now)
            if ahead > _DAY and self._keep_days() is not None:
                log.warning("audit_clock_ahead", seconds=round(ahead), waits=round(_DAY - spent))

    def _believed(self, now: float) -> float:
        """Return the highest level, up to that of the clock, that has lasted for long enough."""
        days = self._keep_days()
        needed = _DAY if days is None else min(1.0, days) * _DAY
        return min(
            now, max((level for level, spent in self._levels if spent >= needed), default=0.0)
        )
