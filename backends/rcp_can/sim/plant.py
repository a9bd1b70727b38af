"""The mechanics of a simulated drive: a rotor with inertia, friction and limits."""

from __future__ import annotations

import math
from typing import Literal

from rcp_can.codec import clamp

__all__ = ["Plant"]

Loop = Literal["off", "torque", "velocity", "position", "mit"]
_STICKS = 0.05  # rad/s below which stiction acts
_STEP = 0.001  # s of one integration step, at most


class Plant:
    """A motor shaft; rad, rad/s, N·m."""

    def __init__(
        self,
        *,
        inertia: float = 0.001,
        friction: float = 0.002,
        stiction: float = 0.01,
        torque_limit: float = 5.0,
        velocity_limit: float = 400.0,
        acceleration_limit: float = 2000.0,
    ) -> None:
        self.inertia, self.friction, self.stiction = inertia, friction, stiction
        self.torque_limit, self.velocity_limit = torque_limit, velocity_limit
        self.acceleration_limit = acceleration_limit
        self.position = self.velocity = self.torque = 0.0
        self.load = 0.0
        """External torque, N·m."""
        self.integrates = True
        """Whether its loops know the load; otherwise only `feed` counters it, as far as it does."""
        self.feed = 0.0
        """A torque that is fed forward, N·m."""
        self.loop: Loop = "off"
        self.goal = 0.0
        self.speed = velocity_limit
        """Maximum velocity of the position loop, rad/s."""
        self.ramp: float | None = None
        """Maximum acceleration of the velocity and position loops, rad/s²."""
        self.kp = self.kd = self.forward = self.forward_velocity = 0.0
        self.temperature = 25.0

    def off(self) -> None:
        """Cut the power: the rotor coasts against friction."""
        self.loop = "off"

    def hold(self) -> None:
        """Keep velocity zero."""
        self.loop, self.goal = "velocity", 0.0

    def impedance(
        self, position: float, velocity: float, kp: float, kd: float, torque: float
    ) -> None:
        """Act as a spring and damper, as in the MIT protocol."""
        self.loop = "mit"
        self.goal, self.forward_velocity, self.kp, self.kd = position, velocity, kp, kd
        self.forward = torque

    def advance(self, dt: float) -> None:
        """Advance the simulation by `dt` s."""
        steps = max(1, math.ceil(dt / _STEP))
        for _ in range(steps):
            self._step(dt / steps)
        self.temperature += (25.0 + 4.0 * self.torque**2 - self.temperature) * min(1.0, dt / 30.0)

    def _step(self, dt: float) -> None:
        limit = self.torque_limit
        match self.loop:
            case "off":
                self.torque = 0.0
            case "torque":
                self.torque = clamp(self.goal, -limit, limit)
            case "velocity":
                self.torque = self._track(self.goal, dt)
            case "position":
                left = self.goal - self.position
                brake = min(
                    self.ramp or self.acceleration_limit,
                    self.acceleration_limit,
                    0.7 * limit / self.inertia,
                )
                wanted = min(self.speed, math.sqrt(2 * brake * abs(left)), abs(left) * 50.0)
                self.torque = self._track(math.copysign(wanted, left), dt)
            case "mit":
                self.torque = clamp(self._impeded(dt), -limit, limit)
        net = self.torque - self.friction * self.velocity + self.load
        if abs(self.velocity) < _STICKS and abs(self._breakaway(net)) <= self.stiction:
            self.velocity = net = 0.0
        self.velocity += net / self.inertia * dt
        self.velocity = clamp(self.velocity, -self.velocity_limit, self.velocity_limit)
        self.position += self.velocity * dt

    def _impeded(self, dt: float) -> float:
        """Return the mean torque of a spring and damper in a step.

        It is implicit in the velocity at the end of the step, so that a stiff damper is stable.
        """
        ours = self._at_standstill() - self.kd * self.velocity
        others = self.load - self.friction * self.velocity
        return (ours + others) / (1 + (self.kd + self.kp * dt) * dt / self.inertia) - others

    def _at_standstill(self) -> float:
        spring = self.kp * (self.goal - self.position)
        return spring + self.kd * self.forward_velocity + self.forward

    def _breakaway(self, net: float) -> float:
        """Return the torque that stiction has to hold, N·m."""
        if self.loop != "mit":
            return net
        limit = self.torque_limit
        return clamp(self._at_standstill(), -limit, limit) + self.load

    def _track(self, wanted: float, dt: float) -> float:
        step = (self.ramp or self.acceleration_limit) * dt
        near = self.velocity + clamp(wanted - self.velocity, -step, step)
        needed = (near - self.velocity) / dt * self.inertia + self.friction * near
        needed += -self.load if self.integrates else self.feed
        return clamp(needed, -self.torque_limit, self.torque_limit)
