"""Dead reckoning of a differential drive from the positions of its wheels."""

from __future__ import annotations

import math
from typing import NamedTuple

import structlog

from rcp_can.axis import Axis
from rcp_can.config_diff_drive import DiffDriveConfig

__all__ = ["Odometry", "Place", "wrapped"]

log = structlog.get_logger("rcp.can")
_FASTER = 2.0  # maximum ratio of the turned angle to the reported velocity
_SLACK = 0.05  # rad
_BUNCH = 0.25  # s of motion that may arrive together after the gateway was late


class Place(NamedTuple):
    """Position of the middle of the axle, m, and heading, rad."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0


class _Seen(NamedTuple):
    """The last counted position of a wheel."""

    position: float
    velocity: float
    at: float
    resets: int
    reports: int


class Odometry:
    """The pose of a differential drive in the frame `odom`.

    The pose never jumps (REP-105): after a gap, a reboot of a drive or a new zero, it continues
    from its last value, without the motion in between.
    """

    def __init__(self, config: DiffDriveConfig, left: Axis, right: Axis) -> None:
        self._config, self._wheels = config, (left, right)
        self.place = Place()
        self._seen: list[_Seen] | None = None
        self._credit = dict.fromkeys(self._wheels, 0.0)
        """Additional angle that a wheel may have turned since the last report, rad."""

    def update(self) -> bool:
        """Count the motion of the wheels; return whether both have reported since the last call."""
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
        """Restart the frame with its origin here."""
        self.place = Place()

    def _turned(self, wheel: Axis, old: _Seen, new: _Seen) -> float | None:
        """Return the angle that a wheel has turned; None if it is unknown."""
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
    """Wrap an angle to the range -π to π."""
    return math.remainder(angle, 2 * math.pi)
