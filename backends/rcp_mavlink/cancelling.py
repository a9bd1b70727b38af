"""COMMAND_CANCEL, which the dialects of pymavlink leave out."""

from __future__ import annotations

import struct
from typing import Any

__all__ = ["cancel_message"]

_ID, _NAME = 80, "COMMAND_CANCEL"
_CRC_EXTRA = 14  # of its fields: uint16_t command, uint8_t target_system, target_component
_FIELDS = struct.Struct("<HBB")


def cancel_message(module: Any, to: tuple[int, int], number: int) -> Any:
    """Build the message, of a dialect's `module`, that ends the command with this number."""

    class Cancel(module.MAVLink_message):
        def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:  # noqa: FBT001, FBT002 - pymavlink's
            fields = _FIELDS.pack(number, *to)
            return self._pack(mav, _CRC_EXTRA, fields, force_mavlink1=force_mavlink1)

    return Cancel(_ID, _NAME)
