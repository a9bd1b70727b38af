"""CiA 301 and 402 as data: objects, PDOs, states, modes, error codes."""

from __future__ import annotations

from typing import NamedTuple

from rcp_can.codec import Field, Layout

__all__ = [
    "ABORT_CONNECTION",
    "COMMANDS",
    "EMERGENCIES",
    "MESSAGES",
    "MODES",
    "OBJECTS",
    "OFFSET_PDO",
    "PDOS",
    "Pdo",
    "State",
    "emergency",
    "state_of",
]


class State(NamedTuple):
    """A state of the power drive system, and its bits in the statusword."""

    name: str
    mask: int
    value: int


# CiA 402-2, table 32
_STATES = (
    State("not_ready", 0x4F, 0x00),
    State("switch_on_disabled", 0x4F, 0x40),
    State("ready", 0x6F, 0x21),
    State("switched_on", 0x6F, 0x23),
    State("enabled", 0x6F, 0x27),
    State("quick_stop", 0x6F, 0x07),
    State("fault_reaction", 0x4F, 0x0F),
    State("fault", 0x4F, 0x08),
)


def state_of(statusword: int) -> str:
    """Return the state of a statusword, or `unknown`."""
    return next((s.name for s in _STATES if statusword & s.mask == s.value), "unknown")


COMMANDS = {
    "shutdown": 0x06,
    "switch_on": 0x07,
    "enable": 0x0F,
    "disable_voltage": 0x00,
    "quick_stop": 0x02,
    "fault_reset": 0x80,
}
"""Controlwords, by the transition they request."""

MODES = {
    "profile_position": 1,
    "profile_velocity": 3,
    "profile_torque": 4,
    "homing": 6,
    "cyclic_position": 8,
    "cyclic_velocity": 9,
    "cyclic_torque": 10,
}

OBJECTS = {
    "heartbeat_consumer": (0x1016, 1, "I"),
    "heartbeat_period": (0x1017, 0, "H"),
    "error_code": (0x603F, 0, "H"),
    "controlword": (0x6040, 0, "H"),
    "statusword": (0x6041, 0, "H"),
    "abort_connection": (0x6007, 0, "h"),
    "quick_stop_option": (0x605A, 0, "h"),
    "mode": (0x6060, 0, "b"),
    "mode_shown": (0x6061, 0, "b"),
    "position": (0x6064, 0, "i"),
    "velocity": (0x606C, 0, "i"),
    "target_torque": (0x6071, 0, "h"),
    "torque": (0x6077, 0, "h"),
    "target_position": (0x607A, 0, "i"),
    "profile_velocity": (0x6081, 0, "I"),
    "profile_acceleration": (0x6083, 0, "I"),
    "profile_deceleration": (0x6084, 0, "I"),
    "homing_method": (0x6098, 0, "b"),
    "homing_search_speed": (0x6099, 1, "I"),
    "homing_zero_speed": (0x6099, 2, "I"),
    "homing_acceleration": (0x609A, 0, "I"),
    "homing_methods": (0x60E3, 0, "B"),
    "torque_offset": (0x60B2, 0, "h"),
    "interpolation_period": (0x60C2, 1, "B"),
    "interpolation_exponent": (0x60C2, 2, "b"),
    "target_velocity": (0x60FF, 0, "i"),
}
"""Index, sub-index and struct code of the objects that the profile uses."""


ABORT_CONNECTION = {1: "fault", 2: "disable_voltage", 3: "quick_stop"}
"""Options of 0x6007, the reaction to a lost master (CiA 402-2, 7.2.5); 0 does nothing."""


class Pdo(NamedTuple):
    """One PDO: index of its parameters, default COB-ID without the node, objects in order."""

    parameters: int
    cob: int
    objects: tuple[str, ...]

    @property
    def layout(self) -> Layout:
        """The payload, in the units of the objects."""
        return Layout("<", *(Field(name, OBJECTS[name][2]) for name in self.objects))


PDOS = {
    "command_position": Pdo(0x1400, 0x200, ("controlword", "mode", "target_position")),
    "command_rate": Pdo(0x1401, 0x300, ("target_velocity", "target_torque")),
    "state": Pdo(0x1800, 0x180, ("statusword", "mode_shown", "position")),
    "motion": Pdo(0x1801, 0x280, ("velocity", "torque")),
}

OFFSET_PDO = PDOS["command_rate"]._replace(objects=(*PDOS["command_rate"].objects, "torque_offset"))
"""What takes the place of `command_rate` if a torque is fed forward."""

MESSAGES = {
    **{name: (pdo.cob, pdo.layout) for name, pdo in PDOS.items()},
    "emergency": (
        0x080,
        Layout("<", Field("code", "H"), Field("register", "B"), Field("vendor", "B")),
    ),
    "heartbeat": (0x700, Layout("<", Field("state", "B"))),
    "nmt": (0x000, Layout("<", Field("command", "B"), Field("node", "B"))),
}

EMERGENCIES = {
    0x1: "generic error",
    0x20: "current",
    0x21: "current, input side",
    0x22: "current inside the device",
    0x23: "over-current at the output",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x43: "drive temperature",
    0x50: "hardware",
    0x54: "power stage",
    0x60: "software",
    0x63: "data set",
    0x70: "additional modules",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol",
    0x84: "velocity controller",
    0x86: "following error",
    0x90: "external error",
    0xF0: "additional functions",
}
"""The upper byte of an error code as text (CiA 301, table 26; CiA 402-2, table 3)."""


_NO_HEARTBEAT = 0x8130  # CiA 301, table 26: life guard error or heartbeat error


def emergency(code: int) -> str:
    """Return an error code as text."""
    if code == _NO_HEARTBEAT:
        return "missed heartbeat"
    upper = code >> 8
    return EMERGENCIES.get(upper) or EMERGENCIES.get(upper & 0xF0) or "device specific"
