"""How a simulated VESC detects its motor: as long as it does, it heeds nothing but a reboot."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from rcp_can.profiles.vesc_detection import DETECT, LAYOUTS
from rcp_can.sim.plant import Plant

__all__ = ["Detection", "MotorConfiguration"]

_SIGNATURE, _LAYOUT = 776184161, LAYOUTS[776184161]
_RESISTANCE, _INDUCTANCE, _LINKAGE = 0.05, 2e-5, 0.0045  # of the motor
_SPEED = 40.0  # rad/s while the flux linkage is measured
_DEFAULTS = -60.0, 60.0, 1500.0, 4000.0
"""What the firmware sets for battery currents and both ERPM if a command leaves them out."""


class MotorConfiguration:
    """The configuration of the motor, as the firmware writes it; floats by their place."""

    def __init__(self) -> None:
        self.data = bytearray(_LAYOUT.size)
        self.data[:4] = _SIGNATURE.to_bytes(4, "big")
        self.put(_LAYOUT.current_max, 60.0)
        self.put(_LAYOUT.openloop_erpm, 700.0)
        self.put(_LAYOUT.sensorless_erpm, 2500.0)

    def put(self, place: int, value: float) -> None:
        """Set a value."""
        struct.pack_into(">f", self.data, place, value)

    def get(self, place: int) -> float:
        """Return a value."""
        return struct.unpack_from(">f", self.data, place)[0]


class Detection:
    """One detection; `advance` returns its result once it has ended."""

    def __init__(self, payload: bytes, plant: Plant, began: float, lasts: float) -> None:
        self._plant, self._began, self._lasts = plant, began, lasts
        given = (each / 1e3 for each in struct.unpack(">5i", payload[2:]))
        self.power_loss, *others = given
        self.others = [
            each if abs(each) > 0.001 else default
            for each, default in zip(others, _DEFAULTS, strict=True)
        ]
        """Battery currents and both ERPM."""

    @staticmethod
    def is_one(payload: bytes) -> bool:
        """Return whether a command begins one, of this drive alone."""
        return payload[0] == DETECT and len(payload) == 22 and payload[1] == 0

    def advance(self, now: float, fails: int) -> int | None:
        """Turn the motor in the middle of the detection; return the result at its end."""
        part = (now - self._began) / self._lasts
        if part < 0.2:
            self._plant.hold()
        elif part < 0.8:
            self._plant.loop, self._plant.goal = "velocity", _SPEED
        else:
            self._plant.hold()
        if part < 1.0:
            return None
        self._plant.off()
        return fails or 1  # it finds hall sensors

    def apply(self, motor: MotorConfiguration, settle: Callable[[float, float], object]) -> None:
        """Set what was measured."""
        motor.put(_LAYOUT.resistance, _RESISTANCE)
        motor.put(_LAYOUT.inductance, _INDUCTANCE)
        motor.put(_LAYOUT.flux_linkage, _LINKAGE)
        motor.put(_LAYOUT.current_max, math.sqrt(self.power_loss / _RESISTANCE))
        self.begin(motor, settle)

    def begin(self, motor: MotorConfiguration, settle: Callable[[float, float], object]) -> None:
        """Set what the command says, which holds whatever comes of it."""
        least, most, openloop, sensorless = self.others
        motor.put(_LAYOUT.openloop_erpm, openloop)
        motor.put(_LAYOUT.sensorless_erpm, sensorless)
        settle(least, most)
