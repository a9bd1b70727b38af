"""Steers to a position or along a velocity: turns first, then drives as fast as the turn allows."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import wrap
from rcp_mavlink_sim.ground.body import Hull
from rcp_mavlink_sim.pilot import Pilot, clip, pace

__all__ = ["GroundPilot"]

_TURN_GAIN = 2.0  # 1/s
_FASTEST_TURN = 1.6  # rad/s
_PIVOT = math.radians(60)  # heading error above which it turns on the spot
_CRAWL = 0.3  # m/s while turning


class GroundPilot(Pilot):
    """Drives a `Hull`."""

    body: Hull

    def __init__(self, body: Hull) -> None:
        super().__init__(body)
        self.near = 0.3
        """Radius within which it rests at its position, m."""
        self.by_hand: tuple[float, float] | None = None
        """Forward speed, m/s, and clockwise rate, rad/s, that override everything else."""

    def hold(self) -> None:
        """Hold the point where it would come to rest if it braked now."""
        super().hold()
        self.by_hand = None

    def at_place(self, tolerance: float) -> bool:
        """Return whether it is at its position; height is ignored."""
        return self.place is not None and self.away() <= max(tolerance, self.near)

    def step(self, dt: float) -> None:
        """Set motor and steering for the next `dt` seconds."""
        body = self.body
        if not self.spinning:
            body.want_speed = body.want_turn = 0.0
        elif self.by_hand is not None:
            body.want_speed, body.want_turn = self.by_hand
        elif self.place is not None:
            dn, de = self.place[0] - body.n, self.place[1] - body.e
            distance = math.hypot(dn, de)
            speed = (
                pace(distance, self.limits.speed, self.limits.acceleration)
                if distance > self.near
                else 0
            )
            self._head(math.atan2(de, dn), speed)
        else:
            self._along()

    def _along(self) -> None:
        body, (vn, ve) = self.body, self.velocity
        speed = min(self.limits.speed, math.hypot(vn, ve))
        forward = vn * math.cos(body.yaw) + ve * math.sin(body.yaw)
        if self.yaw_rate or forward < 0:
            body.want_speed = math.copysign(speed, forward)
            body.want_turn = clip(self.yaw_rate, _FASTEST_TURN)
        else:
            self._head(math.atan2(ve, vn), speed)

    def _head(self, bearing: float, speed: float) -> None:
        body = self.body
        if speed < 1e-3:
            body.want_speed = body.want_turn = 0.0
            return
        off = wrap(bearing - body.yaw)
        body.want_turn = clip(_TURN_GAIN * off, _FASTEST_TURN)
        slower = max(0.0, 1 - abs(off) / _PIVOT)
        body.want_speed = max(min(_CRAWL, speed), speed * slower)
