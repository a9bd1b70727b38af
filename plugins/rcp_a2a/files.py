"""Images in results as file parts, which agents and their models can look at."""

from __future__ import annotations

import base64
import binascii
from typing import Any

from a2a.types.a2a_pb2 import Part

from rcp_protocol.plain import is_list, is_map
from rcp_web.untrusted import UNTRUSTED

__all__ = ["MEDIA", "taken_out"]

MEDIA = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "gif": "image/gif",
}


def taken_out(plain: Any, name: str) -> tuple[Any, list[Part]]:
    """Return a plain value with its image files replaced by their names, and the parts of these."""
    found: list[Part] = []
    return _walk(plain, name, found), found


def _walk(node: Any, name: str, found: list[Part]) -> Any:
    if is_list(node):
        return [_walk(item, name, found) for item in node] if _may_hold(node) else node
    if not is_map(node):
        return node
    media, data = _media(node), node.get("data")
    if media is None or not isinstance(data, str) or not data:
        return {key: _walk(item, name, found) for key, item in node.items()}
    try:
        raw = base64.b64decode(data, validate=True)
    except binascii.Error:
        return node
    suffix = media.rpartition("/")[2]
    part = Part(raw=raw, media_type=media, filename=f"{name}-{len(found) + 1}.{suffix}")
    part.metadata.update({UNTRUSTED: True})
    found.append(part)
    return {**node, "data": f"({media}, {len(raw)} bytes, in the part {part.filename})"}


def _may_hold(items: list[Any]) -> bool:
    return bool(items) and (is_map(items[0]) or is_list(items[0]))


def _media(node: dict[str, Any]) -> str | None:
    words = str(node.get("format", "")).lower().replace(";", " ").split()
    return next((MEDIA[word] for word in words if word in MEDIA), None)
