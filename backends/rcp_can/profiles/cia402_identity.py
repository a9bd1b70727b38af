"""What a CANopen device is: its identity object and the names it has for itself (CiA 301, 7.5.2)."""

from __future__ import annotations

from rcp_can.drive import Identity
from rcp_can.sdo import Sdo
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

__all__ = ["read_identity"]

_NAME, _HARDWARE, _SOFTWARE, _IDENTITY = 0x1008, 0x1009, 0x100A, 0x1018
_VENDOR, _PRODUCT, _REVISION, _SERIAL = 1, 2, 3, 4
_LONGEST = 64  # characters of a name


async def read_identity(sdo: Sdo) -> Identity:
    """Read what there is; only the vendor is mandatory.

    :raises AdapterUnavailable: the bus is down.
    """
    found: dict[tuple[int, int], bytes] = {}
    texts = ((index, 0) for index in (_NAME, _HARDWARE, _SOFTWARE))
    numbers = ((_IDENTITY, sub) for sub in (_VENDOR, _PRODUCT, _REVISION, _SERIAL))
    for index, sub in (*numbers, *texts):
        try:
            found[index, sub] = await sdo.upload(index, sub)
        except DeviceRejected:  # it does not have this one
            continue
        except DeviceTimeout:  # it ignores what it does not have: do not wait for each
            break
    vendor, product, revision, serial = (
        int.from_bytes(found.get((_IDENTITY, sub), b"")[:4], "little")
        for sub in (_VENDOR, _PRODUCT, _REVISION, _SERIAL)
    )
    name, hardware, software = (
        _text(found.get((index, 0), b"")) for index in (_NAME, _HARDWARE, _SOFTWARE)
    )
    model = name or (f"product 0x{product:X}" if product else "")
    if model and hardware:
        model = f"{model}, hardware {hardware}"
    if not software and revision:
        software = f"revision {revision >> 16}.{revision & 0xFFFF}"
    return Identity(
        vendor=f"0x{vendor:X}" if vendor else None,
        model=model or None,
        firmware=software or None,
        serial=str(serial) if serial else None,
    )


def _text(raw: bytes) -> str:
    text = raw.partition(b"\0")[0].decode("ascii", "replace")
    return "".join(filter(str.isprintable, text)).strip()[:_LONGEST]
