"""Monitors the position of driven robots, and stops a robot that is not known to be in its fence.

Keeps every sensor that a limit uses published, so that its current value is known when a command
arrives.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.samples import Sample
from rcp_motion_limits.limits import BoundPath, MotionLimits

__all__ = ["FenceWatch"]

log = structlog.get_logger("rcp.envelopes")
_SOON = 0.01  # s, at least, until a position is looked at again


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
            if bound is not None:
                self._look(bound, sensor)

    def _look(self, bound: BoundPath, sensor: str) -> None:
        """Stop an actuator whose robot is not known to be within the fence of its driver."""
        entry = bound.entry
        driver = self._limits.drivers.get(entry.path)
        if driver is not None and (why := _trouble(bound, driver, sensor)) is not None:
            self._limits.drivers.pop(entry.path)
            self._host.control.stop(entry)
            self._notify(driver, bound, *why)
        elif entry.kind is Kind.ACTION:
            self._look_at_commands(bound, sensor)

    def _look_at_commands(self, bound: BoundPath, sensor: str) -> None:
        for command in self._host.control.running(bound.entry.path):
            if command.requester is None or command.cancelling:
                continue
            why = _trouble(bound, command.requester, sensor)
            if why is not None:
                self._host.control.cancel(command, why[-1])
                self._notify(command.requester, bound, *why)

    def _notify(self, session: Session, bound: BoundPath, sensor: str, name: str, why: str) -> None:
        entry = bound.entry
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


def _trouble(bound: BoundPath, driver: Session, sensor: str) -> tuple[str, str, str] | None:
    """Return the sensor, the violated limit and a description; None if there is none."""
    for envelope in bound.held(driver.principal.grants):
        place = envelope.fence
        if place is None or place.sensor != sensor:
            continue
        where = place.present()
        if where is None:
            why = f"the robot's position is unknown{envelope.why}"
        elif (trouble := place.trouble(*where)) is not None:
            why = f"the robot {trouble[1]}{envelope.why}"
        else:
            continue
        return sensor, envelope.table.name, why
    return None
