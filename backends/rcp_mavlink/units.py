"""The units of MAVLink's definitions, and the corresponding units of the gateway (UCUM)."""

from __future__ import annotations

import math

__all__ = ["converted"]

_DEGREE = math.pi / 180
_STANDARD_GRAVITY = 9.80665  # m/s2

_UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ds": ("s", 1e-1), "cs": ("s", 1e-2), "ms": ("s", 1e-3), "us": ("s", 1e-6),
    "ns": ("s", 1e-9), "Hz": ("Hz", 1.0), "kHz": ("Hz", 1e3), "MHz": ("Hz", 1e6),
    "km": ("m", 1e3), "m": ("m", 1.0), "dm": ("m", 1e-1), "cm": ("m", 1e-2), "mm": ("m", 1e-3),
    "m/s": ("m/s", 1.0), "dm/s": ("m/s", 1e-1), "cm/s": ("m/s", 1e-2), "mm/s": ("m/s", 1e-3),
    "m/s/s": ("m/s2", 1.0), "mG": ("m/s2", _STANDARD_GRAVITY * 1e-3),
    "deg": ("rad", _DEGREE), "cdeg": ("rad", _DEGREE * 1e-2), "degE5": ("rad", _DEGREE * 1e-5),
    "degE7": ("deg", 1e-7), "rad": ("rad", 1.0),
    "deg/s": ("rad/s", _DEGREE), "cdeg/s": ("rad/s", _DEGREE * 1e-2), "rad/s": ("rad/s", 1.0),
    "mrad/s": ("rad/s", 1e-3), "mgauss": ("T", 1e-7), "gauss": ("T", 1e-4),
    "V": ("V", 1.0), "cV": ("V", 1e-2), "mV": ("V", 1e-3), "A": ("A", 1.0), "cA": ("A", 1e-2),
    "mA": ("A", 1e-3), "mAh": ("A.h", 1e-3), "hJ": ("J", 1e2), "W": ("W", 1.0),
    "%": ("1", 1e-2), "d%": ("1", 1e-3), "c%": ("1", 1e-4),
    "degC": ("Cel", 1.0), "cdegC": ("Cel", 1e-2), "Pa": ("Pa", 1.0), "hPa": ("Pa", 1e2),
    "kPa": ("Pa", 1e3), "kg": ("kg", 1.0), "g": ("kg", 1e-3), "rpm": ("rad/s", math.pi / 30),
    "bytes": ("By", 1.0), "KiB": ("By", 1024.0), "MiB": ("By", 1024.0**2), "bits/s": ("bit/s", 1.0),
    "dB": ("dB", 1.0), "dBm": ("dB[mW]", 1.0), "lx": ("lx", 1.0), "l": ("L", 1.0), "ml": ("L", 1e-3),
}  # fmt: skip


def converted(unit: str, kind: str) -> tuple[str, float]:
    """Return the unit of a field in the tree, and the conversion factor.

    Latitude and longitude stay in degrees, pulses of servos and sticks in microseconds.
    """
    if unit == "us" and kind in ("uint16_t", "int16_t"):
        return "us", 1.0
    return _UNITS.get(unit, (unit.replace("/s/s", "/s2") or "1", 1.0))
