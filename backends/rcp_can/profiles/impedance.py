"""Impedance-controlled drives: one frame carries position, velocity, both gains and torque.

They respond to each frame with one of their own. That gives feedback, and shows when two of them
have the same id: there are more responses than requests.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.bus import Bus
from rcp_can.drive import Drive
from rcp_can.motor_messages import Mode

__all__ = ["FAST", "Gains", "ImpedanceDrive"]

FAST = 0.05  # s: a set-point older than this is not worth sending
_UNDER_WAY = 64  # requests that may have been lost, or wait to be sent
_TOO_MANY = 4  # unsolicited responses


class Gains(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The gains of the control loops."""

    kp: Annotated[float, Meta(ge=0, le=500)] = 50.0
    """Stiffness in mode position, N·m/rad."""
    kd: Annotated[float, Meta(ge=0, le=5)] = 1.0
    """Damping in mode position, N·m·s/rad."""
    velocity_gain: Annotated[float, Meta(gt=0, le=5)] = 2.0
    """Damping in mode velocity, N·m·s/rad."""
    brake: Annotated[float, Meta(gt=0, le=5)] = 5.0
    """Damping in a quick stop, N·m·s/rad."""


class ImpedanceDrive(Drive):
    """The common part of such drives."""

    zeroes = True
    sags = True
    offsets = True

    def __init__(self, node: int, options: Gains, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self._gains = options
        self._spoken = False
        self._owed = 0

    def impede(
        self,
        position: float = 0.0,
        velocity: float = 0.0,
        kp: float = 0.0,
        kd: float = 0.0,
        torque: float = 0.0,
        *,
        urgent: bool = False,
    ) -> None:
        """Send one set-point; rad, rad/s, N·m/rad, N·m·s/rad and N·m at the drive's shaft."""
        raise NotImplementedError

    def query(self) -> None:
        """Request the state of a drive that is off, without moving it."""
        raise NotImplementedError

    def count_query(self) -> None:
        """Count a frame that expects a response."""
        self._spoken = True
        self._owed = min(self._owed + 1, _UNDER_WAY)

    def answered(self) -> None:
        """Count a response."""
        self._owed -= 1
        if self._owed <= -_TOO_MANY:
            self._owed = 0
            self.status.twins += 1

    def poll(self, tick: int) -> None:
        """Keep feedback coming: a damped set-point if the drive is on, a query if not."""
        spoken, self._spoken = self._spoken, False
        if spoken:
            return
        if self.status.enabled:
            self.impede(kd=self._gains.kd)
        else:
            self.query()
        self._spoken = False

    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a set-point, with the gains of its mode."""
        gains = self._gains
        match mode:
            case "position":
                self.impede(value, velocity, gains.kp, gains.kd, self.torque_offset or 0.0)
            case "velocity":
                self.impede(0.0, value, 0.0, gains.velocity_gain, self.torque_offset or 0.0)
            case "torque":
                self.impede(torque=value)

    def stop(self) -> None:
        """Damp with the highest gain."""
        self.impede(kd=self._gains.brake, urgent=True)
