"""Set a CiA 402 drive up by SDO: heartbeats, quick stop, PDOs."""

from __future__ import annotations

import struct

from rcp_can.profiles.cia402_objects import OBJECTS, PDOS
from rcp_can.profiles.cia402_options import Cia402Options
from rcp_can.sdo import Sdo, SdoAborted

__all__ = ["map_pdos", "set_up"]

_ABSENT = 0x06020000, 0x06090011  # no such object, no such sub-index
_READ_ONLY = 0x06010002
_SLOW_DOWN_AND_STAY = 6  # on the quick stop ramp, in quick stop active


async def set_up(sdo: Sdo, options: Cia402Options) -> None:
    """Set heartbeats both ways, and what a quick stop does.

    :raises SdoAborted: the drive refuses what it must have.
    """
    if options.heartbeat:
        await _write(sdo, "heartbeat_period", options.heartbeat)
    if options.watchdog:
        await _optional(sdo, "heartbeat_consumer", options.master << 16 | options.watchdog)
    await _optional(sdo, "quick_stop_option", _SLOW_DOWN_AND_STAY)


async def _write(sdo: Sdo, name: str, value: int) -> None:
    index, sub, code = OBJECTS[name]
    await sdo.download(index, sub, struct.pack("<" + code, value))


async def _optional(sdo: Sdo, name: str, value: int) -> None:
    try:
        await _write(sdo, name, value)
    except SdoAborted as aborted:
        if aborted.abort not in (*_ABSENT, _READ_ONLY):
            raise


async def map_pdos(sdo: Sdo, node: int, options: Cia402Options) -> int:
    """Map all PDOs; return the period of SYNC that the drive needs, ms, or 0.

    :raises SdoAborted: the drive refuses a mapping.
    """
    sync = options.sync
    for name in PDOS:
        sync = await _map(sdo, name, node, options.feedback, sync)
    return sync


async def _map(sdo: Sdo, name: str, node: int, feedback: int, sync: int) -> int:
    """Map one PDO, switched off meanwhile (CiA 301, 7.5.2.36)."""
    pdo, sends = PDOS[name], PDOS[name].parameters >= 0x1800
    cob = pdo.cob + node
    mapping = pdo.parameters + 0x200
    await sdo.download(pdo.parameters, 1, struct.pack("<I", 0x80000000 | cob))
    await sdo.download(mapping, 0, b"\0")
    for sub, entry in enumerate(pdo.objects, 1):
        index, subindex, code = OBJECTS[entry]
        word = index << 16 | subindex << 8 | struct.calcsize(code) * 8
        await sdo.download(mapping, sub, struct.pack("<I", word))
    await sdo.download(mapping, 0, bytes((len(pdo.objects),)))
    if sends and not sync and not await _timed(sdo, pdo.parameters, feedback):
        sync = feedback
    await sdo.download(pdo.parameters, 2, bytes((1 if sync and sends else 255,)))
    await sdo.download(pdo.parameters, 1, struct.pack("<I", cob))
    return sync


async def _timed(sdo: Sdo, parameters: int, feedback: int) -> bool:
    """Set a PDO's event timer; a drive need not have one, and tells by SYNC then."""
    try:
        await sdo.download(parameters, 5, struct.pack("<H", feedback))
    except SdoAborted as aborted:
        if aborted.abort not in _ABSENT:
            raise
        return False
    return True
