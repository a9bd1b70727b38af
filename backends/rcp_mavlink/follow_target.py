"""Where what a vehicle follows is: written by clients or reported by another vehicle, sent as FOLLOW_TARGET."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager
from typing import Any

from msgspec import Struct

from rcp_kernel.errors import InvalidValue, PreconditionFailed, UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_kernel.types import LinearVelocity
from rcp_mavlink import messages as m
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.frames import Frame
from rcp_mavlink.geo import distance, offset
from rcp_mavlink.hub import Hub
from rcp_mavlink.measurement import Measurement
from rcp_mavlink.vehicle import Vehicle

__all__ = ["FOLLOW_TARGET", "FollowTargets", "Target", "can_follow"]

FOLLOW_TARGET = "actuator/follow_target"
_MESSAGE, _REPORT = "FOLLOW_TARGET", "GLOBAL_POSITION_INT"
_POSITION, _VELOCITY, _ATTITUDE = 1, 2, 8  # est_capabilities
_NO_HEADING = 65535
_VALID = 2.0  # s


class Target(Struct, frozen=True, forbid_unknown_fields=True):
    """What is followed, as its own receiver reports it."""

    latitude: m.Latitude | None = None
    longitude: m.Longitude | None = None
    altitude: m.Over = 0.0
    """Above the vehicle's home, m."""
    velocity: LinearVelocity | None = None
    """East, north and up; without it, the vehicle lags behind."""
    heading: m.Angle | None = None
    """Clockwise from north; a vehicle that keeps to one side of it needs it."""


class FollowTargets:
    """The target of one vehicle, of which only the latest counts."""

    def __init__(self, hub: Hub, vehicle: Vehicle, hold: Callable[[], Awaitable[None]]) -> None:
        """Use `hold` when a target is lost that the vehicle follows."""
        self._hub, self._vehicle, self._hold = hub, vehicle, hold
        self._latest: Target | None = None
        self._at = -math.inf
        self._seconds = 0.0
        """For how long the latest one counts."""
        self._relaying = False
        self._seen_speed = 0.0
        """How fast it went between its latest two positions, m/s."""

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(
                name=FOLLOW_TARGET,
                description="Position of what the vehicle follows, in `action/follow` without a `vehicle`. Without a new one in time, the vehicle is told to hold.",
                value=Target,
                examples=({"latitude": -35.3631, "longitude": 149.1652}, {"latitude": -35.3631, "longitude": 149.1653, "velocity": {"x": 1.0, "y": 0.0, "z": 0.0}}),
                live=True, max_age=1.0, valid_for=_VALID, safe={},
            )
        ]  # fmt: skip

    async def write(self, value: Target) -> None:
        """Send a position; an empty one tells that the target is lost.

        :raises InvalidValue: only one of latitude and longitude is given.
        :raises PreconditionFailed: another vehicle is followed, or home is not known, from which its height is given.
        """
        if self._relaying:
            if value == Target():  # of an earlier position: that target is followed no more
                return
            raise PreconditionFailed(
                "follow_target: the vehicle follows another vehicle",
                remedy="Cancel action/follow first.",
            )
        if value == Target():
            lost, self._latest, self._at = self._latest is not None, None, -math.inf
            if lost and self._vehicle.mode == "FOLLOW":
                await self._hold()
            return
        if value.latitude is None or value.longitude is None:
            raise InvalidValue("follow_target: latitude and longitude must be given together")
        self._send(value, math.inf)  # its end is written

    def _send(self, value: Target, seconds: float) -> None:
        make: Any = getattr(self._hub.dialect.module, "MAVLink_follow_target_message", None)
        if make is None:
            raise UnsupportedOperation(f"the dialect has no {_MESSAGE}")
        home = self._vehicle.home
        if home is None:
            raise PreconditionFailed("follow_target: home is not known yet")
        able, speed, q = _POSITION, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        if (v := value.velocity) is not None:
            able, speed = able | _VELOCITY, (v.y, v.x, -v.z)
        if (yaw := value.heading) is not None:
            able, q = able | _ATTITUDE, (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
        nothing = (0.0, 0.0, 0.0)
        message = make(
            round(time.monotonic() * 1e3), able, round((value.latitude or 0.0) * 1e7),
            round((value.longitude or 0.0) * 1e7), home[2] + value.altitude,
            speed, nothing, q, nothing, nothing, 0,
        )  # fmt: skip
        self._hub.send(self._vehicle, message)
        now, before = time.monotonic(), self._latest
        passed = now - self._at
        self._seen_speed = 0.0
        if before is not None and 0 < passed < _VALID:
            self._seen_speed = distance(_place(before), _place(value)) / passed
        self._latest, self._at, self._seconds = value, now, seconds

    @property
    def age(self) -> float:
        """Seconds since the latest position; infinite without one."""
        return time.monotonic() - self._at

    @property
    def is_known(self) -> bool:
        """Whether the latest position still counts."""
        return self._latest is not None and self.age <= self._seconds

    def distance(self) -> float | None:
        """Return the horizontal distance to the target, m; None if one of both is not known."""
        fix, target = self._vehicle.fix, self._latest
        if fix is None or target is None or target.latitude is None or target.longitude is None:
            return None
        return math.hypot(*offset(target.latitude, target.longitude, (fix.lat, fix.lon)))

    def speed(self) -> float:
        """Return how fast the target moves over the ground, m/s, by its velocity or by its last two positions."""
        target = self._latest
        if target is not None and target.velocity is not None:
            return math.hypot(target.velocity.x, target.velocity.y)
        return self._seen_speed

    # Another vehicle

    def vehicle(self, name: str) -> Vehicle:
        """Return another vehicle of this backend by its name.

        :raises InvalidValue: there is none, or it is the vehicle itself.
        """
        names = self._hub.config.names
        known = {names.get(str(s), f"vehicle{s}"): v for s, v in self._hub.vehicles.items()}
        found = known.get(name)
        if found is None or found is self._vehicle:
            others = sorted(n for n, v in known.items() if v is not self._vehicle)
            raise InvalidValue(
                f"follow: this backend has no other vehicle {name}",
                remedy=f"It has {', '.join(others)}."
                if others
                else "Write actuator/follow_target.",
                details={"pointer": "/vehicle"},
            )
        return found

    @contextmanager
    def relayed(self, other: Vehicle) -> Generator[None]:
        """Send each new position that another vehicle reports, while entered: nothing else is followed."""
        measured = Measurement(other, self._hub.config)
        sent = other.received_at.get(_REPORT)

        def take(frame: Frame) -> None:
            nonlocal sent
            if frame.definition.name != _REPORT or self._vehicle.home is None:
                return
            at = other.received_at[_REPORT]
            if at != sent and measured.estimated:  # not what a hung or lost one repeats
                sent = at
                self._relay(frame)

        self._relaying, self._latest, self._at = True, None, -math.inf
        other.on_frame.append(take)
        try:
            yield
        finally:
            if take in other.on_frame:
                other.on_frame.remove(take)
            self._relaying, self._latest, self._at = False, None, -math.inf

    def _relay(self, frame: Frame) -> None:
        f, home = frame.fields(), self._vehicle.home
        if home is None or (f["lat"] == 0 and f["lon"] == 0):  # it has no position
            return
        heading = None if f["hdg"] == _NO_HEADING else math.radians(f["hdg"] / 100)
        velocity = LinearVelocity(f["vy"] / 100, f["vx"] / 100, -f["vz"] / 100)
        above_home = f["alt"] / 1e3 - home[2]
        target = Target(f["lat"] / 1e7, f["lon"] / 1e7, above_home, velocity, heading)
        self._send(target, self._hub.config.feedback_limit)


def _place(target: Target) -> tuple[float, float]:
    return target.latitude or 0.0, target.longitude or 0.0


def can_follow(family: Family) -> bool:
    """Return whether vehicles of a family have a mode for it: copters."""
    return family.kind == "copter" and family.autopilot != "unknown"
