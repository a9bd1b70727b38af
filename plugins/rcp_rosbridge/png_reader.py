"""Reads the text of a message from the pixels of a picture, as rosbridge has it."""

from __future__ import annotations

import base64
import binascii
import struct
import zlib
from collections.abc import Callable, Generator

from rcp_kernel.errors import BadRequest, PayloadTooLarge

__all__ = ["read_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEAD = struct.Struct(">IIBBBBB")
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""Bytes of a pixel by colour type; of those with an alpha channel, it is no text."""
_WIDEST = 65_536  # bytes of a row
_TALLEST = 4096  # rows
_MOST = 1024 * 1024  # bytes of all pixels: undoing a filter takes 0.5 µs for each
_LONGEST = 2 * _MOST  # bytes in base64
_STEP = 1024  # bytes between two pauses
_REMEDY = "Send a PNG with 8 bits per channel whose pixels are the text, as rosbridge has it."
_SIZE = "Send a picture of at most 1 MiB in all, 64 KiB in a row and 4096 rows, or the text itself."


def read_png(data: str) -> Generator[None, None, bytes]:
    """Return the text in a picture, in steps.

    :raises BadRequest: it is not such a picture.
    :raises PayloadTooLarge: it is too large.
    """
    if len(data) > _LONGEST:
        raise PayloadTooLarge(f"a picture of {len(data)} bytes is too large", remedy=_SIZE)
    try:
        width, height, colour, packed = _parts(base64.b64decode(data, validate=True))
    except (binascii.Error, ValueError, struct.error) as error:
        raise BadRequest(f"the picture cannot be read: {error}", remedy=_REMEDY) from None
    pixel = _CHANNELS[colour]
    row = width * pixel
    # Each row costs a copy of what is left of the compressed data.
    if row > _WIDEST or height > _TALLEST or (row + 1) * height > _MOST:
        text = f"a picture of {width} by {height} pixels is too large"
        raise PayloadTooLarge(text, remedy=_SIZE)
    yield
    unpacker = zlib.decompressobj()
    line, text = bytearray(row), bytearray()
    for _ in range(height):
        raw, packed = _next(unpacker, packed, row + 1)
        line = yield from _unfiltered(raw[0], raw[1:], line, pixel)
        text += line if colour in (0, 2) else _without_alpha(line, pixel)
        yield
    return bytes(text.strip(b"\n\0 "))


def _parts(picture: bytes) -> tuple[int, int, int, bytes]:
    """Return the size and colour type of a picture, and its compressed pixels."""
    if not picture.startswith(_SIGNATURE):
        raise ValueError("it is not a PNG")
    at, head, packed = len(_SIGNATURE), b"", b""
    found: list[bytes] = []
    while at + 8 <= len(picture):
        (length,) = struct.unpack_from(">I", picture, at)
        name, body = picture[at + 4 : at + 8], picture[at + 8 : at + 8 + length]
        if name == b"IHDR":
            head = body
        elif name == b"IDAT":
            found.append(body)
        at += 12 + length
    packed = b"".join(found)
    width, height, depth, colour, _, _, interlaced = _HEAD.unpack(head)
    if depth != 8 or interlaced or colour not in _CHANNELS or not width or not height:
        raise ValueError("only 8 bits per channel without interlacing and palette are known")
    return width, height, colour, packed


def _next(unpacker: zlib._Decompress, packed: bytes, size: int) -> tuple[bytes, bytes]:
    """Return the next bytes of the pixels, and what is left of the compressed data."""
    try:
        out = unpacker.decompress(packed, size)
        while len(out) < size and (left := unpacker.unconsumed_tail):
            more = unpacker.decompress(left, size - len(out))
            if not more:
                break
            out += more
    except zlib.error as error:
        raise BadRequest(f"the picture cannot be read: {error}", remedy=_REMEDY) from None
    if len(out) < size:
        raise BadRequest("the picture ends too early", remedy=_REMEDY)
    return out, unpacker.unconsumed_tail


def _unfiltered(
    kind: int, raw: bytes, above: bytearray, pixel: int
) -> Generator[None, None, bytearray]:
    """Undo the filter of a row."""
    if kind == 0:
        return bytearray(raw)
    predict = _PREDICTORS.get(kind)
    if predict is None:
        raise BadRequest(f"the picture has the unknown filter {kind}", remedy=_REMEDY)
    line = bytearray(len(raw))
    for place, byte in enumerate(raw):
        if place % _STEP == _STEP - 1:
            yield
        back = place - pixel
        left, corner = (line[back], above[back]) if back >= 0 else (0, 0)
        line[place] = (byte + predict(left, above[place], corner)) & 0xFF
    return line


def _paeth(left: int, up: int, corner: int) -> int:
    guess = left + up - corner
    distances = abs(guess - left), abs(guess - up), abs(guess - corner)
    nearest = min(distances)
    if distances[0] == nearest:
        return left
    return up if distances[1] == nearest else corner


_PREDICTORS: dict[int, Callable[[int, int, int], int]] = {
    1: lambda left, _up, _corner: left,
    2: lambda _left, up, _corner: up,
    3: lambda left, up, _corner: (left + up) // 2,
    4: _paeth,
}
"""By the filters of the PNG specification."""


def _without_alpha(line: bytearray, pixel: int) -> bytearray:
    kept = bytearray()
    for at in range(0, len(line), pixel):
        kept += line[at : at + pixel - 1]
    return kept
