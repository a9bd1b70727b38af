"""Monitors the position of driven robots, and stops a robot that leaves its fence.

Keeps every sensor that a limit uses published, so that its current value is known when a command
arrives.
"""

from __future__ import annotations

from collections.abc import Callable

import structlog

from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.samples import Sample
from rcp_motion_limits.limits import BoundPath, MotionLimits

__all__ = ["FenceWatch"]

log = structlog.get_logger("rcp.envelopes")


class FenceWatch:
    """Monitors the position sensors of driven robots."""

    def __init__(self, limits: MotionLimits, host: FeatureHost) -> None:
        self._limits = limits
        self._host = host
        self._robots = host.robots
        self._fenced: dict[str, dict[str, None]] = {}
        """By sensor: the paths whose commands depend on it."""
        self._ends: dict[str, Callable[[], None]] = {}
        limits.on_bound.append(self._bound)

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

    def _offer(self, sample: Sample) -> None:
        """Check whether the commands that depend on a sensor may continue."""
        for path in tuple(self._fenced.get(sample.entry.path, ())):
            bound = self._limits.of(path)
            if bound is not None:
                self._look(bound, sample)

    def _look(self, bound: BoundPath, sample: Sample) -> None:
        """Stop an actuator whose robot is outside the fence of its driver."""
        entry = bound.entry
        driver = self._limits.drivers.get(entry.path)
        if driver is not None and (why := _trouble(bound, driver, sample)) is not None:
            self._limits.drivers.pop(entry.path)
            self._host.control.stop(entry)
            self._notify(driver, bound, *why)
        elif entry.kind is Kind.ACTION:
            self._look_at_commands(bound, sample)

    def _look_at_commands(self, bound: BoundPath, sample: Sample) -> None:
        for command in self._host.control.running(bound.entry.path):
            if command.requester is None or command.cancelling:
                continue
            why = _trouble(bound, command.requester, sample)
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


def _trouble(bound: BoundPath, driver: Session, sample: Sample) -> tuple[str, str, str] | None:
    """Return the sensor, the violated limit and a description; None if there is none."""
    for envelope in bound.held(driver.principal.grants):
        place = envelope.fence
        if place is None or place.sensor != sample.entry.path:
            continue
        where = place.of_sample(sample)
        trouble = None if where is None else place.trouble(*where)
        if trouble is not None:
            return sample.entry.path, envelope.table.name, f"the robot {trouble[1]}{envelope.why}"
    return None
