"""Flies a plane to and around a position: course to bank, height to climb, speed to power."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import GRAVITY, wrap
from rcp_mavlink_sim.pilot import Pilot, clip
from rcp_mavlink_sim.plane.body import Wing

__all__ = ["PlanePilot"]

_COURSE_GAIN = 0.8  # 1/s
_HEIGHT_GAIN = 0.35  # 1/s
_SPEED_GAIN = 0.5  # 1/s
_INWARD = 2.5  # gain towards the circle


class PlanePilot(Pilot):
    """Flies a `Wing`; circles `place` unless `passes` is set."""

    body: Wing

    def __init__(self, body: Wing) -> None:
        super().__init__(body)
        self.circle = 60.0  # m
        self.bank_most = math.radians(45)
        self.by_hand: tuple[float, float, float] | None = None
        """Bank, path (rad) and power (0…1) that override everything else."""
        self.idle = False

    def hold(self) -> None:
        """Circle the present position."""
        super().hold()
        self.place, self.depth = (self.body.n, self.body.e), self.body.d
        self.by_hand, self.passes, self.idle = None, False, False

    def at_place(self, tolerance: float) -> bool:
        """Return whether it passes its target, or is on the circle and at the height."""
        if self.place is None:
            return False
        if self.passes:
            return self.away() <= tolerance
        low = self.depth is not None and abs(self.depth - self.body.d) > 5
        return self.away() <= self.circle * 1.2 + tolerance and not low

    def step(self, dt: float) -> None:
        """Set the controls for the next `dt` seconds."""
        body = self.body
        if not self.spinning:
            body.want_bank = body.want_path = body.want_power = 0.0
        elif self.by_hand is not None:
            body.want_bank, body.want_path, body.want_power = self.by_hand
        else:
            body.want_bank = self._bank()
            self._energy()

    def _bank(self) -> float:
        body = self.body
        if self.place is None:
            return clip(wrap(self.yaw - body.yaw), self.bank_most)
        dn, de = body.n - self.place[0], body.e - self.place[1]
        away = math.hypot(dn, de)
        outward = math.atan2(de, dn)
        if self.passes:
            course = outward + math.pi
        else:
            course = outward + math.pi / 2 + math.atan(_INWARD * (away / self.circle - 1))
        off = wrap(course - math.atan2(body.ve, body.vn))
        turn = _COURSE_GAIN * off
        if not self.passes and away < 2 * self.circle:
            turn += body.airspeed / self.circle
        return clip(math.atan(turn * body.airspeed / GRAVITY), self.bank_most)

    def _energy(self) -> None:
        body, limits = self.body, self.limits
        speed = max(8.0, body.airspeed)
        climb = -self.sinking
        if self.depth is not None:
            wanted = _HEIGHT_GAIN * (body.d - self.depth)
            climb = max(-limits.down, min(limits.up, wanted))
        body.want_path = math.asin(clip(climb / speed, 0.5))
        if self.idle:
            body.want_power = 0.0
        else:
            body.want_power = body.power_for(_SPEED_GAIN * (limits.speed - body.airspeed))
