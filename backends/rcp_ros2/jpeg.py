"""JPEG encoding of `sensor_msgs/msg/Image`, and the CompressedImage message.

Uses libjpeg-turbo through simplejpeg, which releases the GIL, so that a separate thread runs in
parallel.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from rcp_kernel.errors import DeviceRejected

__all__ = ["SUPPORTED", "compress", "is_here", "wrapped"]

_EDGE = 65_500  # pixels per side that libjpeg accepts
_FORMAT = b"jpeg\0"
_BAYER = {"rggb": (0, 1, 2, 3), "bggr": (3, 1, 2, 0), "gbrg": (2, 0, 3, 1), "grbg": (1, 0, 3, 2)}
"""Positions of red, both greens and blue in a square of 2 x 2 (0 1 / 2 3)."""


def is_here() -> bool:
    """Return whether the library is installed."""
    return find_spec("simplejpeg") is not None


def compress(image: Any, quality: int) -> bytes:
    """Encode an image as JPEG; of more than eight bits per channel, the upper eight are used.

    :raises DeviceRejected: its encoding is not supported, or its sizes contradict each other.
    """
    how = _HOW.get(image.encoding)
    if how is None:
        raise DeviceRejected(
            f"cannot convert an image with encoding '{image.encoding}' to JPEG",
            remedy="Subscribe to the image itself: its pixel format is unsupported or has no colours.",
            details={"encoding": image.encoding, "supported": list(SUPPORTED)},
        )
    width, height = image.width, image.height
    if not (0 < width <= _EDGE and 0 < height <= _EDGE):
        raise DeviceRejected(f"a JPEG cannot have {width} x {height} pixels")
    make, channels, depth = how
    row = width * channels * depth
    if image.step < row or len(image.data) < image.step * height:
        raise DeviceRejected(
            f"{len(image.data)} bytes in rows of {image.step} do not contain {width} x {height} pixels "
            f"of '{image.encoding}'"
        )
    return make(_pixels(image, channels, depth), quality)


def wrapped(message: bytes, jpeg: bytes) -> bytes:
    """Return a serialized CompressedImage with the header of a serialized Image."""
    order = "<" if message[1] == 1 else ">"
    (length,) = struct.unpack_from(order + "I", message, 12)
    head = bytearray(message[: 16 + length])
    for part in (_FORMAT, jpeg):
        head += bytes(-len(head) % 4) + struct.pack(order + "I", len(part))
        head += part
    return bytes(head)


def _pixels(image: Any, channels: int, depth: int) -> Any:
    """Return the pixels as an array of height x width x channels, of eight bits."""
    import numpy as np

    height, width, step = image.height, image.width, image.step
    rows = np.frombuffer(image.data, np.uint8, step * height).reshape(height, step)
    values = rows[:, : width * channels * depth]
    if depth == 2:
        values = values[:, 0 if image.is_bigendian else 1 :: 2]
    return np.ascontiguousarray(values).reshape(height, width, channels)


def _as(colours: str) -> Callable[[Any, int], bytes]:
    def make(pixels: Any, quality: int) -> bytes:
        import simplejpeg

        halved = "" if colours == "GRAY" else "420"
        return simplejpeg.encode_jpeg(
            pixels, quality=quality, colorspace=colours, colorsubsampling=halved or "Gray"
        )

    return make


def _mosaic(pattern: str) -> Callable[[Any, int], bytes]:
    red, green, green_too, blue = _BAYER[pattern]
    encode = _as("RGB")

    def make(pixels: Any, quality: int) -> bytes:
        """Demosaic by replacing each 2 x 2 square by one colour, at full size."""
        import numpy as np

        grey = pixels[: len(pixels) // 2 * 2, : pixels.shape[1] // 2 * 2, 0]
        if not grey.size:
            raise DeviceRejected("a Bayer image needs at least 2 x 2 pixels")
        square = [grey[i // 2 :: 2, i % 2 :: 2] for i in range(4)]
        mean = (square[green].astype(np.uint16) + square[green_too]) // 2
        small = np.stack([square[red], mean.astype(np.uint8), square[blue]], axis=-1)
        return encode(np.ascontiguousarray(small.repeat(2, axis=0).repeat(2, axis=1)), quality)

    return make


def _packed(luma: int) -> Callable[[Any, int], bytes]:
    """Unpack 4:2:2, which JPEG stores natively; `luma` is the index of the first Y."""

    def make(pixels: Any, quality: int) -> bytes:
        import numpy as np
        import simplejpeg

        flat = pixels.reshape(len(pixels), -1)
        flat = flat[:, : flat.shape[1] // 4 * 4]
        if not flat.size:
            raise DeviceRejected("a 4:2:2 image needs at least two columns")
        planes = [flat[:, luma::2], flat[:, 1 - luma :: 4], flat[:, 3 - luma :: 4]]
        y, u, v = (np.ascontiguousarray(plane) for plane in planes)
        return simplejpeg.encode_jpeg_yuv_planes(y, u, v, quality=quality)

    return make


_HOW: dict[str, tuple[Callable[[Any, int], bytes], int, int]] = {
    "rgb8": (_as("RGB"), 3, 1),
    "bgr8": (_as("BGR"), 3, 1),
    "8UC3": (_as("BGR"), 3, 1),
    "rgba8": (_as("RGBA"), 4, 1),
    "bgra8": (_as("BGRA"), 4, 1),
    "8UC4": (_as("BGRA"), 4, 1),
    "mono8": (_as("GRAY"), 1, 1),
    "8UC1": (_as("GRAY"), 1, 1),
    "mono16": (_as("GRAY"), 1, 2),
    "rgb16": (_as("RGB"), 3, 2),
    "bgr16": (_as("BGR"), 3, 2),
    "rgba16": (_as("RGBA"), 4, 2),
    "bgra16": (_as("BGRA"), 4, 2),
    "uyvy": (_packed(1), 2, 1),
    "yuv422": (_packed(1), 2, 1),
    "yuyv": (_packed(0), 2, 1),
    "yuv422_yuy2": (_packed(0), 2, 1),
    **{
        f"bayer_{pattern}{bits}": (_mosaic(pattern), 1, bits // 8)
        for pattern in _BAYER
        for bits in (8, 16)
    },
}
"""Conversion of each encoding: function, number of channels, bytes per channel."""
SUPPORTED = tuple(_HOW)
