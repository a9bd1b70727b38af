"""Configure a CiA 402 drive by SDO, and read back heartbeats, quick stop and PDOs."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

from rcp_can.drive import Protection
from rcp_can.profiles.cia402_objects import ABORT_CONNECTION, OBJECTS, Pdo
from rcp_can.profiles.cia402_options import Cia402Options
from rcp_can.sdo import Sdo, SdoAborted
from rcp_kernel.errors import DeviceRejected

__all__ = ["SetUp", "has_object", "map_pdos", "set_up"]

_ABSENT = 0x06020000, 0x06090011  # no such object, no such sub-index
_READ_ONLY = 0x06010002
_WRITE_ONLY = 0x06010001
_INTERPOLATION = "interpolation_period", "interpolation_exponent"
_WHOLE, _BYTE = 1e-6, 255
_HOLDING = range(5, 9)  # quick stop options that end in quick stop active


class SetUp(NamedTuple):
    """The settings in force, as read from the drive."""

    protection: Protection
    holds_after_stop: bool | None
    """Whether it holds torque after a quick stop; None: not reported."""


async def set_up(sdo: Sdo, options: Cia402Options, watchdog: float | None, rate: float) -> SetUp:
    """Set heartbeats, quick stop, loss reaction and interpolation; return the settings in force.

    :raises SdoAborted: the drive refuses a required setting.
    """
    if options.heartbeat:
        await _write(sdo, "heartbeat_period", options.heartbeat)
    if options.quick_stop is not None:
        await _optional(sdo, "quick_stop_option", options.quick_stop)
    after = await _read(sdo, "quick_stop_option")
    for name, value in zip(_INTERPOLATION, _interpolation(rate), strict=True):
        with suppress(SdoAborted):  # optional, and fixed in some drives
            await _write(sdo, name, value)
    if watchdog is not None:
        reaction = next(n for n, word in ABORT_CONNECTION.items() if word == options.on_silence)
        with suppress(SdoAborted):  # the setting in force is read below
            await _write(sdo, "abort_connection", reaction)
        word = options.master << 16 | round(watchdog * 1000)
        await _optional(sdo, "heartbeat_consumer", word)
    return SetUp(
        await _protection(sdo, options.master), None if after is None else after in _HOLDING
    )


def _interpolation(rate: float) -> tuple[int, int]:
    """Return period and exponent of cyclic set-points (CiA 402-2, 0x60C2): milliseconds if they fit.

    A drive that takes them for more frequent than they are hurries to each, and waits there.
    """
    period = 1 / rate
    whole = abs(period * 1000 - round(period * 1000)) < _WHOLE
    exponents = (-3, -4, -2) if whole else (-4, -3, -2)
    steps = [(round(period / 10**exponent), exponent) for exponent in exponents]
    return next(step for step in steps if step[0] <= _BYTE)


async def _protection(sdo: Sdo, master: int) -> Protection:
    """Read how the drive reacts to a lost gateway."""
    word = await _read(sdo, "heartbeat_consumer")
    reaction = await _read(sdo, "abort_connection")
    if word is None:
        return Protection("no heartbeat consumer (0x1016): it does not detect a lost gateway")
    node, period = word >> 16 & 0x7F, word & 0xFFFF
    if not period:
        return Protection("heartbeat consumer 0x1016 is off")
    if node != master:
        return Protection(f"heartbeat consumer 0x1016 watches node {node}, not the gateway")
    if reaction == 0:
        return Protection(f"heartbeat consumer 0x1016 = {period} ms, but 0x6007 = 0: no reaction")
    if reaction is None:
        text = f"heartbeat consumer 0x1016 = {period} ms; no 0x6007, so the drive's own reaction"
        return Protection(text, period / 1000)
    done = ABORT_CONNECTION.get(reaction, "manufacturer-specific")
    text = f"heartbeat consumer 0x1016 = {period} ms, abort connection 0x6007 = {reaction} ({done})"
    return Protection(text, period / 1000, reaction in ABORT_CONNECTION)


async def _write(sdo: Sdo, name: str, value: int) -> None:
    index, sub, code = OBJECTS[name]
    await sdo.download(index, sub, struct.pack("<" + code, value))


async def _optional(sdo: Sdo, name: str, value: int) -> None:
    try:
        await _write(sdo, name, value)
    except SdoAborted as aborted:
        if aborted.abort not in (*_ABSENT, _READ_ONLY):
            raise


async def _read(sdo: Sdo, name: str) -> int | None:
    """Read an optional object; None if it does not exist."""
    index, sub, code = OBJECTS[name]
    try:
        data = await sdo.upload(index, sub)
    except SdoAborted as aborted:
        if aborted.abort not in (*_ABSENT, _WRITE_ONLY):
            raise
        return None
    size = struct.calcsize(code)
    return struct.unpack("<" + code, data[:size])[0] if len(data) >= size else None


async def has_object(sdo: Sdo, name: str) -> bool:
    """Tell whether a drive has an optional object."""
    return await _read(sdo, name) is not None


async def map_pdos(sdo: Sdo, node: int, options: Cia402Options, pdos: Iterable[Pdo]) -> int:
    """Map PDOs; return the SYNC period that the drive needs, ms, or 0.

    :raises SdoAborted: the drive refuses a mapping.
    :raises DeviceRejected: it accepts a mapping but keeps another.
    """
    sync = options.sync
    for pdo in pdos:
        sync = await _map(sdo, pdo, node, options.feedback, sync)
    return sync


async def _map(sdo: Sdo, pdo: Pdo, node: int, feedback: int, sync: int) -> int:
    """Map one PDO, disabled meanwhile (CiA 301, 7.5.2.36)."""
    sends = pdo.parameters >= 0x1800
    cob = pdo.cob + node
    mapping = pdo.parameters + 0x200
    await sdo.download(pdo.parameters, 1, struct.pack("<I", 0x80000000 | cob))
    await sdo.download(mapping, 0, b"\0")
    words: list[int] = []
    for sub, entry in enumerate(pdo.objects, 1):
        index, subindex, code = OBJECTS[entry]
        words.append(index << 16 | subindex << 8 | struct.calcsize(code) * 8)
        await sdo.download(mapping, sub, struct.pack("<I", words[-1]))
    await sdo.download(mapping, 0, bytes((len(pdo.objects),)))
    if sends and not sync and not await _timed(sdo, pdo.parameters, feedback):
        sync = feedback
    await sdo.download(pdo.parameters, 2, bytes((1 if sync and sends else 255,)))
    await sdo.download(pdo.parameters, 1, struct.pack("<I", cob))
    await _verify(sdo, mapping, words)
    return sync


async def _verify(sdo: Sdo, mapping: int, words: list[int]) -> None:
    """Read a mapping back: some drives accept any, and keep their own."""
    count = (await sdo.upload(mapping, 0))[:1]
    found = [
        int.from_bytes((await sdo.upload(mapping, sub))[:4], "little")
        for sub in range(1, (count[0] if count else 0) + 1)
    ]
    if found != words:
        kept = ", ".join(f"0x{word:08X}" for word in found) or "nothing"
        raise DeviceRejected(
            f"the drive accepted the PDO mapping 0x{mapping:04X} but kept {kept}",
            remedy="Use the drive's own PDO mapping: map_pdos = false, with its EDS.",
        )


async def _timed(sdo: Sdo, parameters: int, feedback: int) -> bool:
    """Set a PDO's event timer; return false if the drive has none and needs SYNC."""
    try:
        await sdo.download(parameters, 5, struct.pack("<H", feedback))
    except SdoAborted as aborted:
        if aborted.abort not in _ABSENT:
            raise
        return False
    return True
