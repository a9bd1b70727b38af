"""Endpoints of an ODrive: its settings by number, which depend on its firmware (0.6 or newer)."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, Protocol, Self

from rcp_can.drive import Identity, Protection
from rcp_kernel.errors import DeviceRejected

__all__ = ["Endpoints", "set_watchdog"]

_TIMEOUT, _ENABLED = "axis0.config.watchdog_timeout", "axis0.config.enable_watchdog"


class _Drive(Protocol):
    """A drive whose endpoints can be accessed."""

    @property
    def identity(self) -> Identity | None:
        """What it is, as far as it has told."""
        ...

    async def read_endpoint(self, number: int) -> int:
        """Read an endpoint, as a raw 32-bit value."""
        ...

    def write_endpoint(self, number: int, value: int) -> None:
        """Write an endpoint."""
        ...


class Endpoints:
    """The numbers of the settings that the gateway uses, for one firmware and hardware."""

    def __init__(self, firmware: str, numbers: dict[str, int]) -> None:
        self.firmware, self._numbers = firmware, numbers

    @classmethod
    def load(cls, file: str) -> Self:
        """Read `flat_endpoints.json`.

        :raises ValueError: it cannot be read, or lacks a setting.
        """
        try:
            found: Any = json.loads(Path(file).read_text(encoding="utf-8"))
            numbers = {name: int(found["endpoints"][name]["id"]) for name in (_TIMEOUT, _ENABLED)}
            return cls(str(found["fw_version"]), numbers)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"endpoints: {file} is not a flat_endpoints.json: {error!r}"
            ) from error

    def __getitem__(self, name: str) -> int:
        return self._numbers[name]


async def set_watchdog(drive: _Drive, endpoints: Endpoints, time: float | None) -> Protection:
    """Set the watchdog, unless `time` is None, and return what is read back.

    :raises DeviceRejected: the endpoints belong to other firmware, or it keeps another time.
    """
    told = drive.identity.firmware if drive.identity is not None else None
    if told != endpoints.firmware:  # a number may be another setting there
        raise DeviceRejected(
            f"`endpoints` belongs to firmware {endpoints.firmware}, and the drive has {told}",
            remedy="Use the flat_endpoints.json of the drive's firmware.",
        )
    if time is not None:
        drive.write_endpoint(endpoints[_TIMEOUT], _word(time))
        drive.write_endpoint(endpoints[_ENABLED], 1)
    found = struct.unpack("<f", struct.pack("<I", await drive.read_endpoint(endpoints[_TIMEOUT])))[
        0
    ]
    enabled = bool(await drive.read_endpoint(endpoints[_ENABLED]) & 0xFF)
    if time is not None and not (enabled and abs(found - time) < 1e-3):
        raise DeviceRejected(
            f"the drive kept its watchdog {'on' if enabled else 'off'}, with {found:g} s",
            remedy="Set it by odrivetool, and `watchdog = false` for this motor.",
        )
    if not enabled:
        return Protection("axis watchdog is off")
    return Protection(f"axis watchdog, {found:g} s", found, verified=True)


def _word(value: float) -> int:
    return struct.unpack("<I", struct.pack("<f", value))[0]
