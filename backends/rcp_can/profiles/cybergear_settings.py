"""The parameters of a CyberGear that are settings; it forgets what is written at a loss of supply."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from rcp_can.settings import Setting, Settings
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

__all__ = ["PARAMETERS", "CyberGearSettings", "Parameter"]


class Parameter(NamedTuple):
    """One parameter; without bounds it can only be read."""

    number: int
    code: str
    low: float | None = None
    high: float = 200.0


PARAMETERS = {
    "run_mode": Parameter(0x7005, "B"),
    "limit_torque": Parameter(0x700B, "f", 0.0, 12.0),
    "cur_kp": Parameter(0x7010, "f", 0.0),
    "cur_ki": Parameter(0x7011, "f", 0.0),
    "cur_filt_gain": Parameter(0x7014, "f", 0.0, 1.0),
    "limit_spd": Parameter(0x7017, "f", 0.0, 30.0),
    "limit_cur": Parameter(0x7018, "f", 0.0, 23.0),
    "loc_kp": Parameter(0x701E, "f", 0.0),
    "spd_kp": Parameter(0x701F, "f", 0.0),
    "spd_ki": Parameter(0x7020, "f", 0.0),
    "canTimeout": Parameter(0x7028, "I"),
}
"""Run mode and time-out are set by the gateway; set-points and measurements are none."""
_LATEST = "canTimeout"
"""Older firmware does not have it."""


class _Drive(Protocol):
    """A drive with parameters."""

    async def read_parameter(self, index: int) -> int:
        """Read a parameter, as its raw 32 bits."""
        ...

    async def write_parameter(self, index: int, raw: int) -> None:
        """Write a parameter."""
        ...


class CyberGearSettings(Settings):
    """The parameters of one drive."""

    known: Mapping[str, Setting] = {
        name: Setting(writable=False) if each.low is None else Setting(low=each.low, high=each.high)
        for name, each in PARAMETERS.items()
    }

    def __init__(self, drive: _Drive) -> None:
        self._drive = drive

    async def read_all(self, tell: Callable[[float], object]) -> dict[str, str]:
        """Read all."""
        found: dict[str, str] = {}
        for done, name in enumerate(PARAMETERS, 1):
            try:
                found[name] = await self.read(name)
            except (DeviceRejected, DeviceTimeout):
                if name != _LATEST:
                    raise
            tell(done / len(PARAMETERS))
        return found

    async def read(self, name: str) -> str:
        """Read one."""
        parameter = PARAMETERS[name]
        raw = struct.pack("<I", await self._drive.read_parameter(parameter.number))
        return f"{struct.unpack_from('<' + parameter.code, raw)[0]:.8g}"

    async def write(self, name: str, value: str) -> None:
        """Write one."""
        raw = struct.pack("<f", float(value))
        await self._drive.write_parameter(PARAMETERS[name].number, struct.unpack("<I", raw)[0])
