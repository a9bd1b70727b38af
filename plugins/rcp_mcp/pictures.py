"""Images within values: detection, and conversion to what a model can look at for few tokens."""

from __future__ import annotations

import base64
import binascii
from io import BytesIO
from typing import Any, NamedTuple

from PIL import Image, UnidentifiedImageError

from rcp_protocol.plain import is_list, is_map

__all__ = ["Picture", "View", "drawn", "taken_out"]

_FORMATS = frozenset(("png", "jpg", "jpeg", "webp", "gif"))
_MEDIA = {"PNG": "image/png", "JPEG": "image/jpeg", "WEBP": "image/webp", "GIF": "image/gif"}
_LAYOUTS = {
    "rgb8": ("RGB", "RGB"),
    "bgr8": ("RGB", "BGR"),
    "rgba8": ("RGBA", "RGBA"),
    "bgra8": ("RGBA", "BGRA"),
    "mono8": ("L", "L"),
}
"""Mode of the image and layout of its pixels, by the encoding's name in ROS."""
_QUALITY = 80
_PIXELS = 16_000_000
_PER_TOKEN = 750  # pixels; models differ


class View(NamedTuple):
    """How a model wants to see pictures."""

    size: int
    """Longest side, in pixels; smaller pictures stay as they are."""
    crop: tuple[float, ...] | None = None
    """Left, top, width and height of the part to show, as fractions of the picture."""


class Picture(NamedTuple):
    """An image as base64."""

    media: str
    data: str
    width: int
    height: int

    @property
    def size(self) -> int:
        """Approximate size in bytes."""
        return len(self.data) * 3 // 4

    @property
    def words(self) -> str:
        """What stands for it in the value."""
        return f"({self.media}, {self.width} x {self.height}, shown as a picture)"

    @property
    def tokens(self) -> int:
        """Estimate what it costs a model to look at it."""
        return -(-self.width * self.height // _PER_TOKEN)


def taken_out(plain: Any, view: View) -> tuple[Any, list[Picture]]:
    """Return a plain value with its images replaced by text, and the images."""
    found: list[Picture] = []
    return _walk(plain, view, found), found


def drawn(image: Image.Image) -> Picture:
    """Return an image of few colours as a PNG."""
    return _encoded(image, "PNG")


def _walk(node: Any, view: View, found: list[Picture]) -> Any:
    if is_list(node) and node and is_map(node[0]):
        return [_walk(item, view, found) for item in node]
    if not is_map(node):
        return node
    data = node.get("data")
    if not isinstance(data, str) or not data or not _is_picture(node):
        return {key: _walk(item, view, found) for key, item in node.items()}
    picture = _picture(node, data, view)
    if picture is None:
        return {**node, "data": f"({len(data) * 3 // 4} bytes, no readable picture)"}
    found.append(picture)
    return {**node, "data": picture.words}


def _is_picture(node: dict[str, Any]) -> bool:
    words = str(node.get("format", "")).lower().replace(";", " ").split()
    return not _FORMATS.isdisjoint(words) or node.get("encoding") in _LAYOUTS


def _picture(node: dict[str, Any], data: str, view: View) -> Picture | None:
    try:
        raw = base64.b64decode(data)
        image = _decoded(node, raw)
        if image is None:
            return None
        media = _MEDIA.get(image.format or "")
        if media is not None and view.crop is None and max(image.size) <= view.size:
            return Picture(media, data, *image.size)
        return _encoded(_shown(image, view), "PNG" if image.format == "PNG" else "JPEG")
    except (binascii.Error, UnidentifiedImageError, OSError, ValueError, SyntaxError):
        return None  # a camera may send a broken file


def _decoded(node: dict[str, Any], raw: bytes) -> Image.Image | None:
    """Return the image of a file, whose pixels are not read yet, or of raw pixels."""
    layout = _LAYOUTS.get(str(node.get("encoding", "")))
    if layout is None:
        image = Image.open(BytesIO(raw))
        return image if image.width * image.height <= _PIXELS else None
    mode, order = layout
    width, height, step = node.get("width"), node.get("height"), node.get("step")
    if not isinstance(width, int) or not isinstance(height, int):
        return None
    if not 0 < width * height <= _PIXELS:
        return None
    row = width * len(order)
    stride = step if isinstance(step, int) and step >= row else row
    if len(raw) < stride * (height - 1) + row:
        return None
    raw += bytes(stride * height - len(raw))
    return Image.frombytes(mode, (width, height), raw, "raw", order, stride)


def _shown(image: Image.Image, view: View) -> Image.Image:
    if view.crop is not None:
        left, top, width, height = view.crop
        box = (
            round(left * image.width),
            round(top * image.height),
            max(round(min(left + width, 1) * image.width), round(left * image.width) + 1),
            max(round(min(top + height, 1) * image.height), round(top * image.height) + 1),
        )
        cut = image.crop(box)
        cut.format = image.format
        image = cut
    if max(image.size) > view.size:
        image.thumbnail((view.size, view.size))
    return image


def _encoded(image: Image.Image, format_: str) -> Picture:
    if format_ == "JPEG" and image.mode not in ("L", "RGB"):
        image = image.convert("RGB")
    made = BytesIO()
    if format_ == "JPEG":
        image.save(made, "JPEG", quality=_QUALITY)
    else:
        image.save(made, "PNG", optimize=True)
    return Picture(_MEDIA[format_], base64.b64encode(made.getvalue()).decode(), *image.size)
