"""One trigger: its robots, and what is kept of each."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.clock import iso
from rcp_kernel.contract.identity import Principal
from rcp_kernel.features import FeatureHost
from rcp_triggers.machine import Outcome, State
from rcp_triggers.messages import RobotState, TriggerState
from rcp_triggers.place import Place
from rcp_triggers.spec import Conditions, Spec
from rcp_triggers.watch import RobotWatch

__all__ = ["OnRobot", "StoredState", "Trigger"]

_NS = 1_000_000_000
_MINUTE = 60.0


class StoredState(msgspec.Struct, kw_only=True):
    """What the store keeps of a trigger on a robot."""

    active: bool = False
    told: bool = False
    """Whether its last firing was told, so that its end has to be."""
    fired: int | None = None
    """When it fired last, ns."""
    firings: int = 0
    alarm: str | None = None
    """Id of the alarm that it raised last."""
    command: str | None = None
    """Id of the firing whose command has not ended."""


class _Budget:
    """So many firings per minute, as many at once."""

    def __init__(self, per_minute: float) -> None:
        self._rate = per_minute / _MINUTE
        self._most = max(1.0, per_minute)
        self._left = self._most
        self._at = float("-inf")

    def take(self, now: float) -> bool:
        """Take one; return whether there was one left."""
        self._left = min(self._most, self._left + (now - self._at) * self._rate)
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class OnRobot:
    """A trigger on one robot."""

    def __init__(self, watch: RobotWatch, kept: StoredState, per_minute: float) -> None:
        self.watch = watch
        self.place = watch.place
        self.kept = kept
        self.budget = _Budget(per_minute)
        self.suppressed = 0
        self.limited = False
        self.since: int | None = None
        self._state: State = watch.machine.state
        self.command: asyncio.Task[None] | None = None
        """Waits for the end of its command."""
        self.outcome: str | None = None
        self.detail: str | None = None
        self.answer: str | None = None
        """What its last command was answered, in words for its maker alone."""

    def moved(self, now: int) -> bool:
        """Note since when it is in its state; return whether that is new."""
        if self.since is not None and self._state == self.watch.machine.state:
            return False
        self._state, self.since = self.watch.machine.state, now
        return True

    def state(self, *, own: bool) -> RobotState:
        """Describe it, to its maker as `own`."""
        kept = self.kept
        return RobotState(
            robot=self.place.key,
            condition=self.watch.condition,
            state=self.watch.machine.state,
            unknown=self.watch.unknown(),
            since=None if self.since is None else iso(self.since),
            fired=None if kept.fired is None else iso(kept.fired),
            firings=kept.firings,
            suppressed=self.suppressed,
            limited=self.limited,
            outcome=self.outcome,
            detail=self.detail or (self.answer if own else None),
        )


class Transition(NamedTuple):
    """An evaluation of a trigger on a robot that has an outcome."""

    trigger: Trigger
    robot: OnRobot
    outcome: Outcome
    values: dict[str, Any]


class Trigger:
    """A trigger with all its robots."""

    def __init__(
        self,
        key: str,
        name: str,
        spec: Spec,
        maker: Principal | None,
        host: FeatureHost,
        on_transition: Callable[[Transition], None],
        *,
        configured: bool,
        made: int | None = None,
    ) -> None:
        """`key` names it in the store. `maker` is whose rights its commands have.

        :raises ConfigError: the specification is wrong.
        """
        self.key = key
        self.name = name
        self.given = spec
        self.spec = Spec(**{field: getattr(spec, field) for field in Spec.__struct_fields__})
        self.maker = maker
        self.configured = configured
        self.made = made
        self.conditions = Conditions(spec)
        self.stopped: str | None = None
        self.robots: dict[Place, OnRobot] = {}
        self._host = host
        self._on_transition = on_transition

    def wants(self, place: Place) -> bool:
        """Return whether it has to take a robot in."""
        return place not in self.robots and self.conditions.robots.matches(place)

    def add(self, place: Place, kept: StoredState, per_minute: float) -> None:
        """Take a robot in."""
        watch = RobotWatch(self.conditions, self.spec.timing, place, self._host, self._came)
        if kept.fired is not None:
            ago = (self._host.clock.now() - kept.fired) / _NS
            watch.machine.resume(self._host.loop.time() - max(0.0, ago), active=kept.active)
        self.robots[place] = OnRobot(watch, kept, per_minute)
        if self.stopped is None:
            watch.open()

    def _came(self, watch: RobotWatch, outcome: Outcome, values: dict[str, Any]) -> None:
        robot = self.robots.get(watch.place)
        if robot is not None and self.stopped is None:
            self._on_transition(Transition(self, robot, outcome, values))

    def stop(self, reason: str) -> None:
        """Evaluate no more."""
        self.stopped = reason
        for robot in self.robots.values():
            robot.watch.close()

    def resume(self) -> None:
        """Evaluate again."""
        self.stopped = None
        for robot in self.robots.values():
            robot.watch.open()

    def close(self) -> None:
        """End it; a command that runs goes on."""
        for robot in self.robots.values():
            robot.watch.close()
            if robot.command is not None:
                robot.command.cancel()

    def is_of(self, reader: Principal) -> bool:
        """Return whether it acts in the name of somebody."""
        return self.maker is not None and self.maker.identity == reader.identity

    def state(self, robots: list[OnRobot], reader: Principal) -> TriggerState:
        """Describe it on some of its robots."""
        own = self.is_of(reader)
        return TriggerState(
            trigger=self.name,
            spec=self.spec,
            by=None if self.configured or self.maker is None else self.maker.name,
            made=None if self.made is None else iso(self.made),
            stopped=self.stopped,
            robots=[robot.state(own=own) for robot in robots],
        )
