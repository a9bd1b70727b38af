"""What sets up a CiA 402 drive: homing by a method, storing and restoring of parameters."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Literal, NamedTuple, Protocol

from msgspec import Meta, Struct

from rcp_can.motor_messages import Seconds
from rcp_can.procedure import Procedure
from rcp_can.sdo import Sdo, SdoAborted
from rcp_kernel.errors import DeviceRejected, OutOfRange
from rcp_kernel.spi import Progress

__all__ = ["Homed", "HomingRequest", "Parameters", "Units", "cia402_procedures"]

_LONGEST = 600.0  # s of homing
_STORING = 10.0  # s that a drive may take to store its parameters
_GROUPS = {"all": 1, "communication": 2, "application": 3}
"""Sub-indices of 0x1010 and 0x1011 (CiA 301, 7.5.2.13)."""
_STORE, _RESTORE = (0x1010, b"save"), (0x1011, b"load")
_ON_COMMAND = 1  # bit of a sub-index: it stores, or restores, if it is told to
_ABSENT = 0x06020000, 0x06090011
_SPEEDS = {"search_speed": "homing_search_speed", "zero_speed": "homing_zero_speed"}

Method = Annotated[int, Meta(ge=-128, le=127, extra_json_schema={"unit": "1"})]
Velocity = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})]
Acceleration = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})]
Limit = Annotated[float, Meta(gt=0, le=_LONGEST, extra_json_schema={"unit": "s"})]


class HomingRequest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How to home; what is not given stays as it is in the drive."""

    method: Method
    """Number of CiA 402-2 (0x6098); negative ones are the manufacturer's."""
    search_speed: Velocity | None = None
    """At the joint, while it searches the switch (0x6099:1)."""
    zero_speed: Velocity | None = None
    """At the joint, while it searches the zero (0x6099:2)."""
    acceleration: Acceleration | None = None
    """At the joint (0x609A)."""
    timeout: Limit = 60.0


class Homed(Struct, frozen=True, kw_only=True):
    """The drive has found its reference; its position counts from there."""

    duration: Seconds


class Parameters(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which parameters."""

    group: Literal["all", "communication", "application"] = "all"


class Units(NamedTuple):
    """What the drive counts in, at the joint."""

    velocity: float
    """Its units per rad/s."""
    acceleration: float
    """Its units per rad/s²."""


class _Drive(Protocol):
    """A drive with the objects of CiA 402."""

    @property
    def server(self) -> Sdo:
        """Its SDO client."""
        ...

    async def read(self, name: str) -> int:
        """Read an object of the profile."""
        ...

    async def write(self, name: str, value: int) -> None:
        """Write an object of the profile."""
        ...

    async def find_reference(self, seconds: float, begun: Callable[[], object]) -> None:
        """Home by the method in the drive; tell when it has been started."""
        ...


def cia402_procedures(drive: _Drive, units: Units, velocity: float) -> Sequence[Procedure]:
    """List the procedures; `velocity` is the limit of the joint."""

    def check(wanted: HomingRequest) -> None:
        for field in _SPEEDS:
            speed: float | None = getattr(wanted, field)
            if speed is not None and speed > velocity:
                raise _too_fast(field, speed, velocity)

    async def home(wanted: HomingRequest, progress: Progress) -> Homed:
        began = time.monotonic()
        await _set_up_homing(drive, wanted, units, velocity)
        await drive.find_reference(wanted.timeout, progress)
        return Homed(duration=time.monotonic() - began)

    async def store(wanted: Parameters, _progress: Progress) -> None:
        await _sign(drive, *_STORE, wanted.group)

    async def restore(wanted: Parameters, _progress: Progress) -> None:
        await _sign(drive, *_RESTORE, wanted.group)

    return (
        Procedure(
            "homing",
            "Find the reference by a method of CiA 402; the drive moves by itself.",
            home,
            needs="enabled",
            motion="own",
            input=HomingRequest,
            output=Homed,
            examples=({"method": 35},),
            timeout=_LONGEST,
            check=check,
        ),
        Procedure(
            "store_parameters",
            "Store its parameters (0x1010), so that they survive a loss of supply.",
            store,
            needs="disabled",
            input=Parameters,
            examples=({"group": "all"},),
            timeout=_STORING,
        ),
        Procedure(
            "restore_parameters",
            "Restore the factory's parameters (0x1011); they apply after the next reset.",
            restore,
            needs="disabled",
            input=Parameters,
            examples=({"group": "all"},),
            timeout=_STORING,
        ),
    )


async def _set_up_homing(
    drive: _Drive, wanted: HomingRequest, units: Units, velocity: float
) -> None:
    """Write the method and speeds, and read back that the drive has taken them.

    :raises OutOfRange: the drive has no such method, or would home faster than allowed.
    :raises DeviceRejected: it keeps another value.
    """
    known = await _methods(drive)
    if known and wanted.method not in known:
        listed = ", ".join(map(str, known))
        raise OutOfRange(
            f"the drive has no homing method {wanted.method}; it has {listed}",
            details={"pointer": "/method"},
        )
    await _write(drive, "homing_method", wanted.method)
    for field, name in _SPEEDS.items():
        speed: float | None = getattr(wanted, field)
        if speed is not None:
            await _write(drive, name, max(1, round(speed * units.velocity)))
            continue
        try:
            kept = await drive.read(name) / units.velocity
        except SdoAborted as aborted:
            if aborted.abort not in _ABSENT:
                raise
            continue
        if kept > velocity:
            raise _too_fast(field, kept, velocity)
    if wanted.acceleration is not None:
        ramp = max(1, round(wanted.acceleration * units.acceleration))
        await _write(drive, "homing_acceleration", ramp)


async def _methods(drive: _Drive) -> list[int]:
    """Read the supported methods (0x60E3); none if the drive does not list them."""
    try:
        count = await drive.read("homing_methods")
        raw = [await drive.server.upload(0x60E3, sub) for sub in range(1, count + 1)]
    except SdoAborted as aborted:
        if aborted.abort not in _ABSENT:
            raise
        return []
    return [int.from_bytes(each[:1], "little", signed=True) for each in raw]


async def _write(drive: _Drive, name: str, value: int) -> None:
    await drive.write(name, value)
    found = await drive.read(name)
    if found != value:
        raise DeviceRejected(f"the drive kept {name.replace('_', ' ')} {found} instead of {value}")


async def _sign(drive: _Drive, index: int, signature: bytes, group: str) -> None:
    """Write the signature that stores or restores; a drive confirms when it has done so.

    :raises DeviceRejected: it cannot, or not for this group.
    """
    sub = _GROUPS[group]
    able = int.from_bytes((await drive.server.upload(index, sub))[:4], "little")
    if not able & _ON_COMMAND:
        raise DeviceRejected(f"the drive does not do this on command for {group} parameters")
    await drive.server.download(index, sub, signature, seconds=_STORING)


def _too_fast(field: str, speed: float, limit: float) -> OutOfRange:
    name = field.replace("_", " ")
    return OutOfRange(
        f"the {name} {speed:.4g} rad/s exceeds the motor's limit of {limit:g} rad/s",
        details={"pointer": f"/{field}"},
        remedy=f"Give a lower `{field}`.",
    )
