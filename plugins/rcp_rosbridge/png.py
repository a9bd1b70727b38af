"""PNG compression: the text of a message as the pixels of a picture, as rosbridge has it."""

from __future__ import annotations

import base64
import math
import struct
import zlib

import msgspec

__all__ = ["to_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGB = 2  # colour type
_PIXEL = 3  # bytes


def to_png(message: bytes) -> bytes:
    """Return the operation `png` with a message; line breaks fill the last row."""
    pixels = math.ceil(len(message) / _PIXEL)
    width = max(1, math.floor(math.sqrt(pixels)))
    height = math.ceil(pixels / width) or 1
    row = width * _PIXEL
    padded = message.ljust(row * height, b"\n")
    rows = b"".join(b"\0" + padded[at : at + row] for at in range(0, row * height, row))
    head = struct.pack(">IIBBBBB", width, height, 8, _RGB, 0, 0, 0)
    picture = (
        _SIGNATURE
        + _chunk(b"IHDR", head)
        + _chunk(b"IDAT", zlib.compress(rows, 1))
        + _chunk(b"IEND", b"")
    )
    return msgspec.json.encode({"op": "png", "data": base64.b64encode(picture).decode()})


def _chunk(name: bytes, data: bytes) -> bytes:
    checksum = struct.pack(">I", zlib.crc32(name + data))
    return struct.pack(">I", len(data)) + name + data + checksum
