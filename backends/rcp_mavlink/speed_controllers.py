"""What the electronic speed controllers (ESCs) of a vehicle's motors report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_mavlink.frames import Frame

__all__ = ["SpeedController", "reported", "reports"]

_ARDUPILOT = tuple(f"ESC_TELEMETRY_{first}_TO_{first + 3}" for first in range(1, 33, 4))
_PX4 = ("ESC_STATUS", "ESC_INFO")
_EACH = 4  # motors a message
_RADIANS = math.tau / 60  # rad/s of one revolution per minute
_UNKNOWN = 32767


class SpeedController(Struct, frozen=True):
    """One speed controller; what it does not report is null."""

    motor: Annotated[int, Meta(ge=1, extra_json_schema={"unit": "1"})]
    velocity: Annotated[float, Meta(extra_json_schema={"unit": "rad/s"})]
    """Of the motor; most report its amount only."""
    voltage: Annotated[float, Meta(extra_json_schema={"unit": "V"})]
    current: Annotated[float, Meta(extra_json_schema={"unit": "A"})]
    temperature: Annotated[float, Meta(extra_json_schema={"unit": "Cel"})] | None
    consumed: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "A.h"})] | None
    errors: Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})] | None
    """Number of errors since boot."""


def reported(known: Mapping[str, Any], *, px4: bool) -> tuple[str, ...]:
    """Return the messages that a dialect has of a family; the first of them brings a new value."""
    return tuple(name for name in (_PX4 if px4 else _ARDUPILOT) if name in known)


def reports(frames: Mapping[str, Frame], _: str | None = None) -> list[SpeedController]:
    """Return those that have reported: of ArduPilot all, of PX4 the four of the latest message."""
    status = frames.get(_PX4[0])
    found = _px4(status, frames.get(_PX4[1])) if status is not None else _ardupilot(frames)
    return list(found)


def _ardupilot(frames: Mapping[str, Frame]) -> Iterator[SpeedController]:
    for at, name in enumerate(_ARDUPILOT):
        frame = frames.get(name)
        if frame is None:
            continue
        f = frame.fields()
        for one in range(_EACH):
            if not f["count"][one]:  # it has never reported
                continue
            yield SpeedController(
                motor=at * _EACH + one + 1,
                velocity=f["rpm"][one] * _RADIANS,
                voltage=f["voltage"][one] / 100,
                current=f["current"][one] / 100,
                temperature=float(f["temperature"][one]),
                consumed=f["totalcurrent"][one] / 1000,
                errors=None,
            )


def _px4(status: Frame, info: Frame | None) -> Iterator[SpeedController]:
    f, more = status.fields(), None if info is None else info.fields()
    if more is not None and more["index"] != f["index"]:
        more = None
    for one in range(_EACH):
        at = f["index"] + one
        if more is not None and not more["info"] & (1 << at):  # offline, or there is none
            continue
        if more is None and not f["voltage"][one]:
            continue
        hundredths = _UNKNOWN if more is None else more["temperature"][one]
        yield SpeedController(
            motor=at + 1,
            velocity=f["rpm"][one] * _RADIANS,
            voltage=f["voltage"][one],
            current=f["current"][one],
            temperature=None if hundredths == _UNKNOWN else hundredths / 100,
            consumed=None,
            errors=None if more is None else more["error_count"][one],
        )
