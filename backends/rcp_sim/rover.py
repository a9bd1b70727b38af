"""The rover's kinematics: a differential drive with limited accelerations and a bumper."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_sim.messages import TOP_SPEED, TOP_TURN

__all__ = ["ACCEL", "BRAKE", "HARD_BRAKE", "RADIUS", "TURN_ACCEL", "Rover", "wrapped"]

RADIUS = 0.25  # m, radius of the body
ACCEL = 1.0  # m/s2
BRAKE = 2.5  # m/s2
HARD_BRAKE = 6.0  # m/s2, when halting
TURN_ACCEL = 4.0  # rad/s2
HARD_TURN_BRAKE = 12.0  # rad/s2


def wrapped(angle: float) -> float:
    """Wrap an angle to -π…π."""
    return math.remainder(angle, 2 * math.pi)


def _toward(now: float, target: float, up: float, down: float) -> float:
    """Change a velocity by at most `up` away from zero, or at most `down` towards it."""
    if now and (target * now < 0 or abs(target) < abs(now)):
        limit = target if target * now > 0 else 0.0
        return max(limit, now - down) if now > 0 else min(limit, now + down)
    return min(target, now + up) if target > now else max(target, now - up)


class Rover:
    """Pose and velocities, integrated over time; deterministic."""

    def __init__(self, x: float, y: float, yaw: float) -> None:
        self.x = x
        self.y = y
        self.yaw = wrapped(yaw)
        self.v = 0.0
        """Forward speed, m/s."""
        self.w = 0.0
        """Angular velocity, rad/s, left positive."""
        self.accel = 0.0
        """Forward acceleration of the last step, m/s2."""
        self.travelled = 0.0
        """Total distance since the start, reversing counted as positive, m."""
        self.path = 0.0
        """Distance since the start, reversing counted as negative, m."""
        self.turned = 0.0
        """Angle turned since the start, left positive, rad."""
        self.bumped = False
        """Whether an obstacle stopped the last step."""

    @property
    def at_rest(self) -> bool:
        """Whether it is at rest."""
        return self.v == 0.0 and self.w == 0.0

    def step(
        self,
        dt: float,
        v: float,
        w: float,
        clearance: Callable[[float, float], float],
        *,
        hard: bool = False,
    ) -> None:
        """Drive for `dt` seconds towards the velocities `v` and `w`; obstacles stop it."""
        v = max(-TOP_SPEED, min(TOP_SPEED, v))
        w = max(-TOP_TURN, min(TOP_TURN, w))
        before, turning = self.v, self.w
        self.v = _toward(before, v, ACCEL * dt, (HARD_BRAKE if hard else BRAKE) * dt)
        slow = HARD_TURN_BRAKE if hard else TURN_ACCEL
        self.w = _toward(turning, w, TURN_ACCEL * dt, slow * dt)
        self.bumped = False
        distance = (before + self.v) / 2 * dt
        turn = (turning + self.w) / 2 * dt
        if distance:
            self._advance(distance, self.yaw + turn / 2, clearance)
        if turn:
            self.yaw = wrapped(self.yaw + turn)
            self.turned += turn
        self.accel = (self.v - before) / dt

    def _advance(
        self, distance: float, heading: float, clearance: Callable[[float, float], float]
    ) -> None:
        x = self.x + distance * math.cos(heading)
        y = self.y + distance * math.sin(heading)
        room = clearance(x, y)
        if room < RADIUS and room < clearance(self.x, self.y):
            self.v = 0.0
            self.bumped = True
            return
        self.x, self.y = x, y
        self.path += distance
        self.travelled += abs(distance)
