"""Dead reckoning of a differential drive from the positions of its wheels."""

from __future__ import annotations

import math
from typing import NamedTuple

import structlog

from rcp_can.axis import Axis
from rcp_can.config_diff_drive import DiffDriveConfig

__all__ = ["Odometry", "Place", "wrapped"]

log = structlog.get_logger("rcp.can")
_FASTER = 2.0  # times its reported velocity that a wheel may have turned
_SLACK = 0.05  # rad
_BUNCH = 0.25  # s of motion that may arrive at once, after the gateway was late


class Place(NamedTuple):
    """Where the middle of the axle is, m, and its heading, rad."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0


class _Seen(NamedTuple):
    """The last position of a wheel that has been counted."""

    position: float
    velocity: float
    at: float
    resets: int
    reports: int


class Odometry:
    """The place of a differential drive in the frame `odom`.

    The place never jumps (REP-105): after a gap, a reboot of a drive or a new zero, it goes on from where
    it was, and what a wheel turned meanwhile is not in it.
    """

    def __init__(self, config: DiffDriveConfig, left: Axis, right: Axis) -> None:
        self._config, self._wheels = config, (left, right)
        self.place = Place()
        self._seen: list[_Seen] | None = None
        self._credit = dict.fromkeys(self._wheels, 0.0)
        """What a wheel may have turned since the last report beyond what it did, rad."""

    def update(self) -> bool:
        """Count what the wheels have turned; tell whether both have reported since the last time."""
        now = [_look(wheel) for wheel in self._wheels]
        if any(seen is None for seen in now):
            return False
        fresh: list[_Seen] = [seen for seen in now if seen is not None]
        before = self._seen
        if before is not None and any(
            new.reports == old.reports for new, old in zip(fresh, before, strict=True)
        ):
            return False
        self._seen = fresh
        if before is None:
            return True
        turned = [
            self._turned(wheel, old, new)
            for wheel, old, new in zip(self._wheels, before, fresh, strict=True)
        ]
        if None in turned:
            log.info("odometry_gap", wheels=[wheel.name for wheel in self._wheels])
        else:
            self._advance(*(radians for radians in turned if radians is not None))
        return True

    def reset(self) -> None:
        """Begin a new frame: here is the origin."""
        self.place = Place()

    def _turned(self, wheel: Axis, old: _Seen, new: _Seen) -> float | None:
        """Return by how much a wheel has turned; None if that is not known."""
        gap, turned = new.at - old.at, new.position - old.position
        known = new.resets == old.resets and gap <= wheel.limit_of("position")
        speed = _FASTER * max(abs(old.velocity), abs(new.velocity))
        credit = min(self._credit[wheel] + speed * gap, speed * _BUNCH)
        self._credit[wheel] = max(0.0, credit - abs(turned))
        return turned if known and abs(turned) <= credit + _SLACK else None

    def _advance(self, left: float, right: float) -> None:
        radius, place = self._config.radius, self.place
        way, turn = radius * (left + right) / 2, radius * (right - left) / self._config.track
        middle = place.heading + turn / 2  # second-order Runge-Kutta: the chord of the arc
        self.place = Place(
            place.x + way * math.cos(middle),
            place.y + way * math.sin(middle),
            wrapped(place.heading + turn),
        )


def _look(wheel: Axis) -> _Seen | None:
    status, position, velocity = wheel.status, wheel.position, wheel.velocity
    if position is None or velocity is None or not wheel.configured:
        return None
    if "position" not in status.at:
        return None
    at, reports = status.at["position"], status.counts["position"]
    return _Seen(position, velocity, at, status.resets, reports)


def wrapped(angle: float) -> float:
    """Return an angle between -π and π."""
    return math.remainder(angle, 2 * math.pi)
