"""The rover's battery: energy balance and terminal voltage."""

from __future__ import annotations

__all__ = ["LOW", "Pack"]

LOW = 0.15  # of the capacity, below which the rover warns
IDLE_POWER = 8.0  # W, computer and sensors
DRIVE_POWER = 35.0  # W for each m/s
TURN_POWER = 12.0  # W for each rad/s
CHARGE_POWER = 150.0  # W into the pack
FULL, EMPTY = 12.6, 9.9  # V without load, a lithium pack of three cells
RESISTANCE = 0.08  # Ohm


class Pack:
    """Stored energy; `charge` is the remaining fraction of `capacity` (W.h), 0…1."""

    def __init__(self, capacity: float, charge: float) -> None:
        self.capacity = capacity
        self.energy = capacity * charge
        self.charging = False
        self.power = IDLE_POWER

    @property
    def charge(self) -> float:
        """Remaining fraction of the capacity, 0…1."""
        return max(0.0, min(1.0, self.energy / self.capacity))

    @property
    def current(self) -> float:
        """Current into the pack, A; negative while discharging."""
        return -self.power / (EMPTY + (FULL - EMPTY) * self.charge)

    @property
    def voltage(self) -> float:
        """Terminal voltage under the present load, V."""
        return EMPTY + (FULL - EMPTY) * self.charge + self.current * RESISTANCE

    def step(self, dt: float, v: float, w: float) -> None:
        """Consume the energy for driving at `v` (m/s) and `w` (rad/s) for `dt` seconds."""
        self.power = IDLE_POWER + DRIVE_POWER * abs(v) + TURN_POWER * abs(w)
        if self.charging and self.charge < 1.0:
            self.power -= CHARGE_POWER
        self.energy = max(0.0, min(self.capacity, self.energy - self.power * dt / 3600))
