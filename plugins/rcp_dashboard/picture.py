"""From a camera's value to an image for browsers: files unchanged, raw pixels as JPEG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected

__all__ = ["Picture", "picture"]

_EDGE = 65_500  # pixels, libjpeg's limit per side
_FILES = ((b"\xff\xd8\xff", b"image/jpeg"), (b"\x89PNG\r\n\x1a\n", b"image/png"))
_LAYOUTS = {
    "rgb8": ("RGB", 3),
    "bgr8": ("BGR", 3),
    "8uc3": ("BGR", 3),
    "rgba8": ("RGBA", 4),
    "bgra8": ("BGRA", 4),
    "8uc4": ("BGRA", 4),
    "mono8": ("GRAY", 1),
    "8uc1": ("GRAY", 1),
}
"""Colours and bytes per pixel, by the encoding names of ROS and others."""
_MEASURES = {"16uc1": "u2", "mono16": "u2", "32fc1": "f4"}
"""Encodings with one number per pixel, mostly depths."""


class Picture(msgspec.Struct, frozen=True):
    """An image file."""

    media: bytes
    data: bytes


def picture(value: Any, quality: int) -> Picture:
    """Convert a value to an image file: bytes, or an object with `data`, for raw pixels with size.

    Takes milliseconds for raw pixels, so not on the event loop.

    :raises DeviceRejected: it is not an image, or cannot be converted to JPEG.
    :raises AdapterUnavailable: the library for JPEG is not installed.
    """
    data = value.get("data") if isinstance(value, Mapping) else value
    if isinstance(data, (bytes, bytearray, memoryview)):
        head = bytes(data[:8])
        for magic, media in _FILES:
            if head.startswith(magic):
                return Picture(media, bytes(data))
        if isinstance(value, Mapping):
            return Picture(b"image/jpeg", _compress(value, bytes(data), quality))
    raise DeviceRejected(
        "the value is not an image",
        remedy="Use a resource with images: JPEG or PNG bytes, or pixels with width and height.",
    )


def _compress(value: Mapping[str, Any], data: bytes, quality: int) -> bytes:
    named = str(value.get("encoding") or value.get("format") or "")
    kind = _MEASURES.get(named.lower())
    layout = _LAYOUTS.get(named.lower()) if kind is None else ("GRAY", int(kind[1]))
    if layout is None:
        raise DeviceRejected(
            f"cannot convert an image with encoding {named[:40]!r} to JPEG",
            remedy="Read the value itself; for ROS cameras, `<sensor>/jpeg` supports more "
            "encodings.",
            details={"encoding": named, "supported": [*_LAYOUTS, *_MEASURES]},
        )
    colours, depth = layout
    width, height = _side(value.get("width")), _side(value.get("height"))
    step = value.get("step") or width * depth
    if not isinstance(step, int) or step < width * depth or len(data) < step * height:
        raise DeviceRejected(
            f"{len(data)} bytes in rows of {step} are not {width} x {height} pixels of '{named}'"
        )
    try:
        import numpy as np
        import simplejpeg
    except ImportError as error:
        raise AdapterUnavailable(
            f"this gateway cannot convert raw images to JPEG: {error}",
            remedy="Install on the gateway: pip install 'rcp-gateway[dashboard]'.",
        ) from error
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)
    pixels = np.ascontiguousarray(rows[:, : width * depth])
    if kind is None:
        pixels = pixels.reshape(height, width, depth)
    else:
        order = ">" if value.get("is_bigendian") else "<"
        pixels = _greys(pixels.view(order + kind), near=named.lower() != "mono16")
    halved = "Gray" if colours == "GRAY" else "420"
    return simplejpeg.encode_jpeg(
        pixels, quality=quality, colorspace=colours, colorsubsampling=halved
    )


def _greys(measured: Any, *, near: bool) -> Any:
    """Scale numbers to greys, near depths bright; invalid ones are black."""
    import numpy as np

    found = measured.astype(np.float32)
    there = np.isfinite(found) & (found > 0) if near else np.isfinite(found)
    made = np.zeros(found.shape, np.uint8)
    if there.any():
        low, high = found[there].min(), found[there].max()
        part = (found[there] - low) / max(high - low, np.finfo(np.float32).tiny)
        made[there] = 255 - 215 * part if near else 40 + 215 * part
    return made[:, :, np.newaxis]


def _side(value: Any) -> int:
    if isinstance(value, int) and 0 < value <= _EDGE:
        return value
    raise DeviceRejected(f"a JPEG cannot be {value!r} pixels wide or high")
