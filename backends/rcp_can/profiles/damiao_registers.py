"""The registers of a Damiao, as its maker documents them; each is a 32-bit float or integer."""

from __future__ import annotations

import struct
from typing import NamedTuple

__all__ = [
    "BAUD",
    "ESC_ID",
    "MODE",
    "MST_ID",
    "NAMES",
    "RANGES",
    "REGISTERS",
    "SUB_VERSION",
    "TIMEOUT",
    "VERSION",
    "Register",
    "pack",
    "unpack",
]

_TOP = 3.4e38
MST_ID, ESC_ID, TIMEOUT, MODE, VERSION, BAUD, SUB_VERSION = 7, 8, 9, 10, 14, 35, 36
RANGES = 21, 22, 23
"""Full scale of position, velocity and torque in every set-point and response."""


class Register(NamedTuple):
    """One register; without bounds it can only be read."""

    name: str
    code: str
    low: float | None = None
    high: float = _TOP


REGISTERS = {
    0: Register("UV_Value", "f", 10.0),
    1: Register("KT_Value", "f", 0.0),
    2: Register("OT_Value", "f", 80.0, 200.0),
    3: Register("OC_Value", "f", 0.0, 1.0),
    4: Register("ACC", "f", 0.0),
    5: Register("DEC", "f", -_TOP, 0.0),
    6: Register("MAX_SPD", "f", 0.0),
    MST_ID: Register("MST_ID", "I"),
    ESC_ID: Register("ESC_ID", "I"),
    TIMEOUT: Register("TIMEOUT", "I"),
    MODE: Register("CTRL_MODE", "I"),
    11: Register("Damp", "f"),
    12: Register("Inertia", "f"),
    13: Register("hw_ver", "I"),
    VERSION: Register("sw_ver", "I"),
    15: Register("SN", "I"),
    16: Register("NPP", "I"),
    17: Register("Rs", "f"),
    18: Register("Ls", "f"),
    19: Register("Flux", "f"),
    20: Register("Gr", "f"),
    21: Register("PMAX", "f", 1e-3),
    22: Register("VMAX", "f", 1e-3),
    23: Register("TMAX", "f", 1e-3),
    24: Register("I_BW", "f", 100.0, 10_000.0),
    25: Register("KP_ASR", "f", 0.0),
    26: Register("KI_ASR", "f", 0.0),
    27: Register("KP_APR", "f", 0.0),
    28: Register("KI_APR", "f", 0.0),
    29: Register("OV_Value", "f", 10.0),
    30: Register("GREF", "f", 1e-3, 1.0),
    31: Register("Deta", "f", 1.0, 30.0),
    32: Register("V_BW", "f", 1e-3, 500.0),
    33: Register("IQ_c1", "f", 100.0, 10_000.0),
    34: Register("VL_c1", "f", 1e-3, 10_000.0),
    BAUD: Register("can_br", "I"),
    SUB_VERSION: Register("sub_ver", "I"),
}
"""Ids, control mode, time-out and bit rate have no bounds here: they are not written as settings."""
NAMES = {register.name: number for number, register in REGISTERS.items()}


def pack(number: int, text: str) -> int:
    """Return a value as the raw 32 bits of a register."""
    code = REGISTERS[number].code
    value = float(text) if code == "f" else int(float(text))
    return struct.unpack("<I", struct.pack("<" + code, value))[0]


def unpack(number: int, raw: int) -> float | int:
    """Return the value of a register's raw 32 bits."""
    return struct.unpack("<" + REGISTERS[number].code, struct.pack("<I", raw))[0]
