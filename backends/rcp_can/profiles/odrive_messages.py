"""The messages of CANSimple with their payloads, and the errors that they report."""

from __future__ import annotations

import math

from rcp_can.codec import Field, Layout
from rcp_can.drive import Fault

__all__ = ["MESSAGES", "TURN", "faults_of"]

TURN = 2 * math.pi  # rad: ODrive counts turns


def _f(name: str, scale: float = 1.0) -> Field:
    return Field(name, "f", scale)


MESSAGES: dict[str, tuple[int, Layout]] = {
    "version": (
        0x00,
        Layout(
            "<",
            Field("protocol", "B"),
            *(Field(f"hardware_{part}", "B") for part in ("major", "minor", "variant")),
            *(Field(f"firmware_{part}", "B") for part in ("major", "minor", "revision")),
            Field("unreleased", "B"),
        ),
    ),
    "heartbeat": (
        0x01,
        Layout(
            "<",
            Field("error", "I"),
            *(Field(name, "B") for name in ("state", "result", "done", "controller")),
        ),
    ),
    "error": (0x03, Layout("<", Field("active", "I"), Field("disarm_reason", "I"))),
    "access": (
        0x04,
        Layout(
            "<",
            Field("opcode", "B"),
            Field("endpoint", "H"),
            Field("reserved", "B"),
            Field("value", "I"),
        ),
    ),
    "value": (
        0x05,
        Layout(
            "<",
            Field("reserved_0", "B"),
            Field("endpoint", "H"),
            Field("reserved_1", "B"),
            Field("value", "I"),
        ),
    ),
    "address": (
        0x06,
        Layout("<", Field("node", "B"), Field("serial_low", "I"), Field("serial_high", "H")),
    ),
    "state": (0x07, Layout("<", Field("state", "I"))),
    "encoder": (0x09, Layout("<", _f("position", TURN), _f("velocity", TURN))),
    "mode": (0x0B, Layout("<", Field("control", "I"), Field("input", "I"))),
    "position": (
        0x0C,
        Layout(
            "<",
            _f("position", TURN),
            Field("velocity", "h", 0.001 * TURN),
            Field("torque", "h", 0.001),
        ),
    ),
    "velocity": (0x0D, Layout("<", _f("velocity", TURN), _f("torque"))),
    "torque": (0x0E, Layout("<", _f("torque"))),
    "limits": (0x0F, Layout("<", _f("velocity", TURN), _f("current"))),
    "trap_velocity": (0x11, Layout("<", _f("velocity", TURN))),
    "trap_acceleration": (0x12, Layout("<", _f("acceleration", TURN), _f("deceleration", TURN))),
    "current": (0x14, Layout("<", _f("set_point"), _f("measured"))),
    "temperature": (0x15, Layout("<", _f("drive"), _f("motor"))),
    "reboot": (0x16, Layout("<", Field("action", "B"))),
    "supply": (0x17, Layout("<", _f("voltage"), _f("current"))),
    "clear": (0x18, Layout("<", Field("identify", "B"))),
    "absolute": (0x19, Layout("<", _f("position", TURN))),
    "torques": (0x1C, Layout("<", _f("target"), _f("estimate"))),
}
"""Command and payload of each message; in radians, while ODrive uses turns."""

_ERRORS = {
    0: "initializing",
    1: "system level",
    2: "timing",
    3: "missing estimate",
    4: "bad configuration",
    5: "driver fault",
    6: "missing input",
    8: "supply over-voltage",
    9: "supply under-voltage",
    10: "supply over-current",
    11: "supply over-regeneration",
    12: "over-current",
    13: "over-temperature of the motor",
    14: "over-temperature of the drive",
    15: "velocity limit",
    16: "position limit",
    24: "watchdog expired",
    25: "emergency stop",
    26: "spin-out",
    27: "brake resistor off",
    28: "thermistor disconnected",
    30: "calibration",
}


def faults_of(error: int) -> tuple[Fault, ...]:
    """Return the faults of an error word."""
    found = [
        Fault(text.replace(" ", "_"), text, bit)
        for bit, text in _ERRORS.items()
        if error >> bit & 1
    ]
    return tuple(found) if found or not error else (Fault("error", f"error 0x{error:x}", error),)
