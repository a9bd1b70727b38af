"""What sets up a VESC: its limits as settings, its id, and what it tells of itself."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Protocol

from rcp_can.drive import Identity
from rcp_can.node_change import NodeChange
from rcp_can.settings import Setting, Settings
from rcp_kernel.errors import DeviceRejected

__all__ = [
    "GET_APP",
    "GET_LIMITS",
    "LIMITS",
    "SET_APP",
    "SET_LIMITS",
    "SIGNATURES",
    "TOLD",
    "VERSION",
    "PacketDrive",
    "VescSettings",
    "change_node",
    "read_version",
]

VERSION, SET_APP, GET_APP, SET_LIMITS, GET_LIMITS = 0, 16, 17, 48, 91
"""COMM_FW_VERSION, …_SET_APPCONF, …_GET_APPCONF, …_SET_MCCONF_TEMP, …_GET_MCCONF_TEMP of the firmware."""
SIGNATURES = frozenset((486554156, 1146628643))
"""Layouts of the application's configuration that are known: they begin with the id."""
_MAJORS = 5, 6
_ID_AT = 5  # after the command and the signature
_STORES = 3.0  # s

LIMITS: dict[str, Setting] = {
    "l_current_min_scale": Setting(0.0, 1.0),
    "l_current_max_scale": Setting(0.0, 1.0),
    "l_min_erpm": Setting(-1e6, 0.0),
    "l_max_erpm": Setting(0.0, 1e6),
    "l_min_duty": Setting(0.0, 1.0),
    "l_max_duty": Setting(0.0, 1.0),
    "l_watt_min": Setting(-1.5e6, 0.0),
    "l_watt_max": Setting(0.0, 1.5e6),
    "l_in_current_min": Setting(-1e4, 0.0),
    "l_in_current_max": Setting(0.0, 1e4),
}
"""In the order of the packets; named as in VESC Tool's files."""
TOLD = "si_motor_poles", "si_gear_ratio", "si_wheel_diameter"
"""What follows the limits when they are read."""
_LAYOUT = struct.Struct(f">B{len(LIMITS)}fBff")


class PacketDrive(Protocol):
    """A drive that answers packets."""

    node: int
    application: bytes | None
    """The application's configuration that is to be put back, if any."""

    async def ask(
        self,
        payload: bytes,
        *,
        node: int | None = None,
        seconds: float = 1.0,
        once: bool = False,
    ) -> bytes:
        """Return the answer to a command; `node` is another id that may answer."""
        ...

    def lose(self) -> None:
        """Forget its count, with which the next one would be compared."""


class VescSettings(Settings):
    """The limits of one drive, which are read and written together."""

    saves = True
    known: Mapping[str, Setting] = LIMITS | dict.fromkeys(TOLD, Setting(writable=False))

    def __init__(self, drive: PacketDrive) -> None:
        self._drive = drive

    async def prepare(self) -> None:
        """Check the firmware: its packets may have another layout.

        :raises DeviceRejected: it is not known.
        """
        found = await read_version(self._drive)
        major = (found.firmware or "").partition(".")[0]
        if major not in map(str, _MAJORS):
            known = " and ".join(f"{each}.x" for each in _MAJORS)
            raise DeviceRejected(
                f"the drive has firmware {found.firmware}; known are {known}",
                remedy="Set it up with VESC Tool.",
            )

    async def read_all(self, tell: Callable[[float], object]) -> dict[str, str]:
        """Read all, which come in one packet."""
        answer = await self._drive.ask(bytes((GET_LIMITS,)))
        if len(answer) != _LAYOUT.size:
            raise DeviceRejected(
                f"the drive tells its limits in {len(answer)} bytes instead of {_LAYOUT.size}",
                remedy="Set it up with VESC Tool.",
            )
        values = _LAYOUT.unpack(answer)[1:]
        tell(1.0)
        return {name: f"{value:.8g}" for name, value in zip(self.known, values, strict=True)}

    async def read(self, name: str) -> str:
        """Read one."""
        return (await self.read_all(lambda _part: None))[name]

    async def write(self, name: str, value: str) -> None:
        """Write one; the hardware's own limits may reduce it."""
        await self._send({**await self.read_all(lambda _part: None), name: value}, store=False)

    async def save(self) -> None:
        """Store all, with whatever else is in force."""
        await self._send(await self.read_all(lambda _part: None), store=True)

    async def _send(self, values: Mapping[str, str], *, store: bool) -> None:
        limits = struct.pack(f">{len(LIMITS)}f", *(float(values[name]) for name in LIMITS))
        head = bytes(
            (SET_LIMITS, store, False, True, False)
        )  # to no other; confirm; divide by none
        try:
            await self._drive.ask(head + limits, seconds=_STORES, once=True)
        finally:
            self._drive.lose()  # it may count anew


async def read_version(drive: PacketDrive) -> Identity:
    """Ask what a drive is.

    :raises DeviceTimeout: it does not answer.
    """
    answer = await drive.ask(bytes((VERSION,)))
    if len(answer) < 3:
        raise DeviceRejected("the drive does not tell its firmware")
    name, _, rest = answer[3:].partition(b"\0")
    test = f"-test{rest[13]}" if len(rest) > 13 and rest[13] else ""
    return Identity(
        vendor="VESC",
        model=name.decode("ascii", "replace") or None,
        firmware=f"{answer[1]}.{answer[2]:02}{test}",
        serial=rest[:12].hex() if len(rest) >= 12 else None,
    )


async def change_node(drive: PacketDrive, wanted: NodeChange, begun: Callable[[], object]) -> None:
    """Write the id into the configuration of the application, and read it back.

    :raises DeviceRejected: its layout is not known, or the drive keeps another id.
    """
    told = await drive.ask(bytes((GET_APP,)))
    signature = int.from_bytes(told[1:_ID_AT], "big")
    if signature not in SIGNATURES or len(told) <= _ID_AT or told[_ID_AT] != drive.node:
        raise DeviceRejected(
            f"the drive's configuration has the layout {signature}, which is not known",
            remedy="Give it its id with VESC Tool.",
        )
    changed = bytes((SET_APP,)) + told[1:_ID_AT] + bytes((wanted.node,)) + told[_ID_AT + 1 :]
    begun()
    drive.application = None  # it has the old id
    await drive.ask(changed, node=wanted.node, seconds=_STORES, once=True)
    kept = await drive.ask(bytes((GET_APP,)), node=wanted.node)
    if kept[1:] != changed[1:]:
        raise DeviceRejected(
            f"the drive kept another configuration than that with id {wanted.node}"
        )
