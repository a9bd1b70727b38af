"""Images within values: detection and conversion for models."""

from __future__ import annotations

import base64
import struct
import zlib
from importlib.util import find_spec
from typing import Any, NamedTuple

from rcp_protocol.plain import is_list, is_map

__all__ = ["Picture", "taken_out"]

_FORMATS = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "gif": "image/gif",
}
_CHANNELS = {"rgb8": "RGB", "bgr8": "BGR", "rgba8": "RGBA", "bgra8": "BGRA", "mono8": "GRAY"}
_QUALITY = 80
_PIXELS = 16_000_000


class Picture(NamedTuple):
    """An image as base64."""

    media: str
    data: str

    @property
    def size(self) -> int:
        """Approximate size in bytes."""
        return len(self.data) * 3 // 4


def taken_out(plain: Any) -> tuple[Any, list[Picture]]:
    """Return a plain value with its images replaced by text, and the images."""
    found: list[Picture] = []
    return _walk(plain, found), found


def _walk(node: Any, found: list[Picture]) -> Any:
    if is_list(node) and node and is_map(node[0]):
        return [_walk(item, found) for item in node]
    if not is_map(node):
        return node
    picture = _picture(node)
    if picture is None:
        return {key: _walk(item, found) for key, item in node.items()}
    found.append(picture)
    return {**node, "data": f"({picture.media}, {picture.size} bytes, shown as a picture)"}


def _picture(node: dict[str, Any]) -> Picture | None:
    data = node.get("data")
    if not isinstance(data, str) or not data:
        return None
    words = str(node.get("format", "")).lower().replace(";", " ").split()
    media = next((_FORMATS[word] for word in words if word in _FORMATS), None)
    if media is not None:
        return Picture(media, data)
    layout = _CHANNELS.get(str(node.get("encoding", "")))
    width, height = node.get("width"), node.get("height")
    if layout is None or not isinstance(width, int) or not isinstance(height, int):
        return None
    if not 0 < width * height <= _PIXELS:
        return None
    step = node.get("step")
    raw = base64.b64decode(data)
    row = width * (1 if layout == "GRAY" else len(layout))
    stride = step if isinstance(step, int) and step >= row else row
    if len(raw) < stride * (height - 1) + row:
        return None
    pixels = b"".join(raw[at : at + row] for at in range(0, stride * height, stride))
    return _jpeg(pixels, width, height, layout) or _png(pixels, width, height, layout)


def _jpeg(pixels: bytes, width: int, height: int, layout: str) -> Picture | None:
    if find_spec("simplejpeg") is None:
        return None
    import numpy as np
    import simplejpeg

    channels = 1 if layout == "GRAY" else len(layout)
    array = np.frombuffer(pixels, np.uint8).reshape(height, width, channels)
    made = simplejpeg.encode_jpeg(array, quality=_QUALITY, colorspace=layout)
    return Picture("image/jpeg", base64.b64encode(made).decode())


def _png(pixels: bytes, width: int, height: int, layout: str) -> Picture:
    """Encode a PNG, if no library for JPEG is installed."""
    if layout.startswith("BGR"):
        swapped = bytearray(pixels)
        swapped[0 :: len(layout)], swapped[2 :: len(layout)] = (
            pixels[2 :: len(layout)],
            pixels[0 :: len(layout)],
        )
        pixels = bytes(swapped)
    kind = {"GRAY": 0, "RGB": 2, "BGR": 2, "RGBA": 6, "BGRA": 6}[layout]
    row = len(pixels) // height
    lines = b"".join(b"\0" + pixels[at : at + row] for at in range(0, len(pixels), row))
    head = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines, 6)), (b"IEND", b""))
    made = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in parts
    )
    return Picture("image/png", base64.b64encode(made).decode())
