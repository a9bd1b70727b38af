"""Monitors the position of driven robots, and stops a robot that is not known to be in its fence.

Keeps every sensor that a limit uses published, so that its current value is known when a command
arrives. A sample is compared with the fences of its sensor once; only where it violates one are the
commands looked at, and only those of paths with that fence.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.samples import Sample
from rcp_motion_limits.limit import MotionLimit
from rcp_motion_limits.limits import BoundPath, MotionLimits

__all__ = ["FenceWatch"]

log = structlog.get_logger("rcp.envelopes")
_SOON = 0.01  # s, at least, until a position is looked at again

Violations = dict[MotionLimit, str]
"""Violated limits, each with why."""


class FenceWatch:
    """Monitors the position sensors of driven robots."""

    def __init__(self, limits: MotionLimits, host: FeatureHost) -> None:
        self._limits = limits
        self._host = host
        self._robots = host.robots
        self._fenced: dict[str, dict[str, None]] = {}
        """By sensor: the paths whose commands depend on it."""
        self._ends: dict[str, Callable[[], None]] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        """By sensor: when its position becomes too old, while something depends on it."""
        limits.on_bound.append(self._bound)
        host.robots.follow_state(self._state_changed)

    def moving(self, bound: BoundPath) -> None:
        """Note that a command has been sent: it ends when a position that it needs is unknown."""
        for limit in bound.envelopes:
            sensor = None if limit.fence is None else limit.fence.sensor
            if sensor is not None and sensor not in self._timers:
                self._arm(sensor)

    def _bound(self, path: str, old: BoundPath | None, new: BoundPath | None) -> None:
        before = set[str]() if old is None else old.sensors
        after = set[str]() if new is None else new.sensors
        for sensor in after - before:
            fenced = self._fenced.setdefault(sensor, {})
            fenced[path] = None
            if sensor not in self._ends:
                self._ends[sensor] = self._robots.watch(sensor, self._offer)
        for sensor in before - after:
            del self._fenced[sensor][path]
            if not self._fenced[sensor]:
                del self._fenced[sensor]
                self._ends.pop(sensor)()
        for sensor in before | after:
            self._arm(sensor)

    def _arm(self, sensor: str) -> None:
        """Look again when the position becomes too old, while something depends on it."""
        if (timer := self._timers.pop(sensor, None)) is not None:
            timer.cancel()
        remaining: list[float] = []
        for path in self._fenced.get(sensor, ()):
            bound = self._limits.bound(path)
            if bound is not None and self._depends(bound):
                fences = (limit.fence for limit in bound.envelopes)
                remaining += [f.remaining for f in fences if f is not None and f.sensor == sensor]
        if remaining:
            delay = max(min(remaining), _SOON)
            self._timers[sensor] = self._host.loop.call_later(delay, self._expired, sensor)

    def _expired(self, sensor: str) -> None:
        self._check(sensor)
        self._arm(sensor)

    def _depends(self, bound: BoundPath) -> bool:
        entry = bound.entry
        return entry.path in self._limits.drivers or (
            entry.kind is Kind.ACTION
            and any(not command.cancelling for command in self._host.control.running(entry.path))
        )

    def _state_changed(self) -> None:
        """Check positions of robots that may have become unavailable."""
        for sensor in tuple(self._timers):
            entry = self._robots.entries.get(sensor)
            if entry is None or entry.unit.usable_backend is None:
                self._check(sensor)

    def _offer(self, sample: Sample) -> None:
        self._check(sample.entry.path)

    def _check(self, sensor: str) -> None:
        """Check whether the commands that depend on a sensor may continue."""
        for path in tuple(self._fenced.get(sensor, ())):
            bound = self._limits.of(path)
            if bound is None or not self._depends(bound):
                continue
            violated = _violated(bound, sensor)
            if violated:
                self._end(bound, sensor, violated)

    def _end(self, bound: BoundPath, sensor: str, violated: Violations) -> None:
        """End what depends on a violated limit: the value of an actuator, or the runs of an action."""
        entry, control = bound.entry, self._host.control
        driver = self._limits.drivers.get(entry.path)
        if driver is not None and (limit := _first(bound, driver, violated)) is not None:
            self._limits.drivers.pop(entry.path)
            control.stop(entry)
            self._notify(driver, bound, sensor, limit, violated[limit])
        elif entry.kind is Kind.ACTION:
            for command in control.running(entry.path):
                session = command.requester
                if session is None or command.cancelling:
                    continue
                if (limit := _first(bound, session, violated)) is not None:
                    control.cancel(command, violated[limit])
                    self._notify(session, bound, sensor, limit, violated[limit])

    def _notify(
        self, session: Session, bound: BoundPath, sensor: str, limit: MotionLimit, why: str
    ) -> None:
        entry, name = bound.entry, limit.table.name
        log.warning("fence_left", path=entry.path, envelope=name, sensor=sensor, reason=why)
        text = f"{entry.path} was stopped: {why}"
        facts = {"path": entry.path, "envelope": name, "message": text}
        self._host.sessions.tell(session.holder, "fence_left", **facts)
        self._host.note(
            "fence",
            principal=session.principal,
            tenant=entry.tenant,
            path=entry.path,
            touches=(entry.path, sensor),
            outcome="stopped",
            session=session,
            envelope=name,
            reason=why,
        )


def _violated(bound: BoundPath, sensor: str) -> Violations:
    """Return the limits whose fence the robot is not known to be in, of all roles."""
    violated: Violations = {}
    for limit in bound.envelopes:
        fence = limit.fence
        if fence is None or fence.sensor != sensor:
            continue
        where = fence.present()
        if where is None:
            violated[limit] = f"the robot's position is unknown{limit.why}"
        elif (trouble := fence.trouble(*where)) is not None:
            violated[limit] = f"the robot {trouble[1]}{limit.why}"
    return violated


def _first(bound: BoundPath, driver: Session, violated: Violations) -> MotionLimit | None:
    """Return the first of the violated limits that a driver's roles are held to."""
    held = bound.held(driver.principal.grants)
    return next((limit for limit in held if limit in violated), None)
