"""moteus' multiplex protocol: registers written, read and answered, several in one CAN FD frame."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

from rcp_can.codec import clamp

__all__ = [
    "REGISTERS",
    "Access",
    "Kind",
    "Mode",
    "Register",
    "Width",
    "build",
    "pad",
    "parse",
    "step",
]

_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_NOP = 0x50


class Kind(IntEnum):
    """The operation of a subframe."""

    WRITE = 0x00
    READ = 0x10
    REPLY = 0x20
    WRITE_ERROR = 0x30
    READ_ERROR = 0x31


class Width(IntEnum):
    """The encoding of a value."""

    INT8 = 0
    INT16 = 1
    INT32 = 2
    FLOAT = 3


class Mode(IntEnum):
    """The drive's servo mode."""

    STOPPED = 0
    FAULT = 1
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12
    BRAKE = 15


_CODES = "bhif"
_SI = {
    "position": (0.01, 0.0001, 0.00001),
    "velocity": (0.1, 0.00025, 0.00001),
    "acceleration": (0.05, 0.001, 0.00001),
    "torque": (0.5, 0.01, 0.001),
    "current": (1.0, 0.1, 0.001),
    "voltage": (0.5, 0.1, 0.001),
    "temperature": (1.0, 0.1, 0.001),
    "time": (0.01, 0.001, 0.000001),
    "gain": (1 / 127, 1 / 32767, 1 / 2147483647),
    "count": (1.0, 1.0, 1.0),
}


class Register(NamedTuple):
    """A register, and the quantity that gives its resolution."""

    number: int
    quantity: str


REGISTERS = {
    "mode": Register(0x000, "count"),
    "position": Register(0x001, "position"),
    "velocity": Register(0x002, "velocity"),
    "torque": Register(0x003, "torque"),
    "q_current": Register(0x004, "current"),
    "motor_temperature": Register(0x00A, "temperature"),
    "trajectory_complete": Register(0x00B, "count"),
    "home_state": Register(0x00C, "count"),
    "voltage": Register(0x00D, "voltage"),
    "temperature": Register(0x00E, "temperature"),
    "fault": Register(0x00F, "count"),
    "command_position": Register(0x020, "position"),
    "command_velocity": Register(0x021, "velocity"),
    "command_torque": Register(0x022, "torque"),
    "kp_scale": Register(0x023, "gain"),
    "kd_scale": Register(0x024, "gain"),
    "max_torque": Register(0x025, "torque"),
    "stop_position": Register(0x026, "position"),
    "watchdog": Register(0x027, "time"),
    "velocity_limit": Register(0x028, "velocity"),
    "acceleration_limit": Register(0x029, "acceleration"),
    "milliseconds": Register(0x070, "count"),
    "model": Register(0x100, "count"),
    "firmware": Register(0x101, "count"),
    "serial_1": Register(0x120, "count"),
    "serial_2": Register(0x121, "count"),
    "serial_3": Register(0x122, "count"),
    "set_output": Register(0x131, "position"),
}
"""The registers used here; moteus counts turns."""
_QUANTITIES = {register.number: register.quantity for register in REGISTERS.values()}


class Access(NamedTuple):
    """One access to one register; `value` is None for a read."""

    kind: Kind
    register: int
    width: Width
    value: float | None = None


def step(register: int, width: Width) -> float:
    """Return the resolution of an integer encoding."""
    return _SI[_QUANTITIES.get(register, "count")][width]


def _raw(register: int, width: Width, value: float) -> float:
    if width == Width.FLOAT:
        return value if math.isnan(value) else clamp(value, -3.4e38, 3.4e38)
    top = 2 ** (8 * (1 << width) - 1) - 1
    if math.isnan(value):
        return -top - 1
    steps = value / step(register, width)
    return int(clamp(steps if math.isinf(steps) else round(steps), -top, top))


def _value(register: int, width: Width, raw: float) -> float:
    if width == Width.FLOAT:
        return raw
    if raw == -(2 ** (8 * (1 << width) - 1)):
        return math.nan
    return raw * step(register, width)


def build(accesses: Iterable[Access]) -> bytes:
    """Encode the accesses; consecutive ones of one kind and width share a subframe."""
    runs: list[list[Access]] = []
    for access in accesses:
        last = runs[-1][-1] if runs else None
        if last is not None and (last.kind, last.width, last.register + 1) == (
            access.kind,
            access.width,
            access.register,
        ):
            runs[-1].append(access)
        else:
            runs.append([access])
    data = bytearray()
    for run in runs:
        first, count = run[0], len(run)
        head = first.kind | first.width << 2
        data += bytes((head | count,)) if count < 4 else bytes((head, count))
        data += _varuint(first.register)
        if first.kind != Kind.READ:
            values = [_raw(a.register, a.width, a.value or 0.0) for a in run]
            data += struct.pack(f"<{count}{_CODES[first.width]}", *values)
    return bytes(data)


def _varuint(number: int) -> bytes:
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


def pad(data: bytes) -> bytes:
    """Pad the payload with NOPs to the next valid CAN FD size."""
    size = next(size for size in _SIZES if size >= len(data))
    return data.ljust(size, bytes((_NOP,)))


def parse(data: bytes) -> list[Access]:
    """Decode a payload.

    :raises ValueError: it is truncated, or contains an unknown subframe.
    """
    found: list[Access] = []
    place = 0
    try:
        while place < len(data):
            head = data[place]
            place += 1
            if head == _NOP:
                continue
            if head in (Kind.WRITE_ERROR, Kind.READ_ERROR):
                register, place = _number(data, place)
                error, place = _number(data, place)
                found.append(Access(Kind(head), register, Width.INT8, float(error)))
                continue
            if head >= 0x30:
                raise ValueError(f"unknown subframe 0x{head:02X}")
            kind, width, count = Kind(head & 0xF0), Width(head >> 2 & 3), head & 3
            if count == 0:
                count, place = _number(data, place)
            register, place = _number(data, place)
            if count > 64:
                raise ValueError(f"{count} registers at once")
            raws: list[float | None] = [None] * count
            if kind != Kind.READ:
                form = f"<{count}{_CODES[width]}"
                raws = list(struct.unpack_from(form, data, place))
                place += struct.calcsize(form)
            for number, raw in enumerate(raws, register):
                value = None if raw is None else _value(number, width, raw)
                found.append(Access(kind, number, width, value))
    except (IndexError, struct.error) as error:
        raise ValueError("the payload is truncated") from error
    return found


def _number(data: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80 or shift > 28:
            return value, place
