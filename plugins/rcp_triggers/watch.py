"""One trigger on one robot: follows the values of its condition, and steps its state."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import perf_counter
from typing import Any

from rcp_conditions import Condition, Ref
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Kind
from rcp_kernel.tree.samples import Sample
from rcp_triggers.machine import Machine, Outcome, Timing
from rcp_triggers.messages import Known
from rcp_triggers.place import Place
from rcp_triggers.spec import Conditions

__all__ = ["LOOK", "RobotWatch"]

LOOK = 1.0  # s between evaluations without a sample: values become stale, and time passes
_PAUSE = 0.05  # s between two evaluations
_SHARE = 500  # an evaluation that takes t s is followed by none for as many t
_EVENTS = 50  # events per second of which each is looked at
_WORDS: dict[bool | None, Known] = {True: "true", False: "false", None: "unknown"}


class RobotWatch:
    """Evaluates after each sample, but not more often than its cost allows; each event at once.

    `come` is called with what comes of an evaluation and the values of then, never while a sample is
    being published.
    """

    def __init__(
        self,
        conditions: Conditions,
        timing: Timing,
        place: Place,
        host: FeatureHost,
        come: Callable[[RobotWatch, Outcome, dict[str, Any]], None],
    ) -> None:
        self.place = place
        self.machine = Machine(timing)
        self._conditions = conditions
        self._host = host
        self._come = come
        self._ends: list[Callable[[], None]] = []
        self._soon: asyncio.TimerHandle | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._next = 0.0
        """When it may be evaluated again for a sample."""
        self.looked = float("-inf")
        """When it was evaluated last."""
        self.known: bool | None = None
        """Whether the condition holds."""
        self._second = float("-inf")
        self._events = 0

    # -- life ----------------------------------------------------------------------------------

    def open(self) -> None:
        """Follow the values."""
        names = {
            "/".join(ref[:length])
            for one in self._conditions.all
            for ref in one.refs
            for length in range(len(ref), 1, -1)
        }
        watch = self._host.robots.watch
        self._ends = [watch(self.place.path(name), self._offer) for name in sorted(names)]
        self._later(0.0)

    def close(self) -> None:
        """Follow nothing."""
        for end in self._ends:
            end()
        self._ends.clear()
        for timer in (self._soon, self._timer):
            if timer is not None:
                timer.cancel()
        self._soon = self._timer = None

    # -- evaluation ----------------------------------------------------------------------------

    def _offer(self, sample: Sample) -> None:
        now = self._host.loop.time()
        entry = self._host.robots.entries.get(sample.entry.path)
        if entry is not None and entry.kind is Kind.EVENT and self._counts_event(now):
            self.look()
        elif self._soon is None:
            self._later(max(0.0, self._next - now))

    def _counts_event(self, now: float) -> bool:
        if now - self._second >= 1.0:
            self._second, self._events = now, 0
        self._events += 1
        return self._events <= _EVENTS

    def _later(self, seconds: float) -> None:
        self._soon = self._host.loop.call_later(seconds, self._look_now)

    def _look_now(self) -> None:
        self._soon = None
        self.look()

    def look(self) -> None:
        """Evaluate the conditions."""
        loop, began = self._host.loop, perf_counter()
        now = self.looked = loop.time()
        holds, parts = self._host.robots.conditions.holds, self._conditions
        self.known = holds(parts.when, self.place)
        clear = None if parts.clear is None else holds(parts.clear, self.place)
        outcome = self.machine.step(now, when=self.known, clear=clear)
        self._wait_for(self.machine.due)
        self._next = now + max(_PAUSE, (perf_counter() - began) * _SHARE)
        if outcome is not None:
            loop.call_soon(self._come, self, outcome, self.values())

    def _wait_for(self, due: float | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if due is None else self._host.loop.call_at(due, self.look)

    # -- what is known -------------------------------------------------------------------------

    @property
    def condition(self) -> Known:
        """Whether the condition holds, as a word."""
        return _WORDS[self.known]

    def values(self) -> dict[str, Any]:
        """Return the values of the names in the condition that are known."""
        refs = self._conditions.when.refs
        found = self._host.robots.conditions.values(refs, self.place)
        return {".".join(ref): value for ref, value in found.items()}

    def unknown(self) -> dict[str, str]:
        """Return why the condition cannot be evaluated, by name."""
        if self.known is not None:
            return {}
        condition = self._conditions.when
        values = self._host.robots.conditions.values(condition.refs, self.place)
        missing = {ref: self._why(ref) for ref in condition.refs if ref not in values}
        if not missing:
            return {"when": _typed(condition)}
        return {".".join(ref): why for ref, why in missing.items()}

    def _why(self, ref: Ref) -> str:
        found = self._host.robots.conditions.resource(ref, self.place)
        if found is None:
            return "there is no such resource"
        entry, _ = found
        if entry.unit.usable_backend is None:
            return "the robot is not connected"
        if entry.latest is None:
            return "there is no value yet"
        if entry.stale:
            return "the value is stale"
        return "the value has no such field, or is not a finite number"


def _typed(condition: Condition) -> str:
    return f"the values do not have the types that `{condition.text[:80]}` needs, or are too large"
