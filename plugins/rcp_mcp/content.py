"""Values as a model sees them: JSON, images, summaries with a link, and marked untrusted text."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
from mcp import types

from rcp_mcp.naming import uri_of
from rcp_mcp.pictures import View
from rcp_mcp.senses import condensed
from rcp_mcp.summary import PER_TOKEN, cut, size
from rcp_web.untrusted import UNTRUSTED, marked, speaks

__all__ = ["Block", "Shown", "show", "text"]

Block = types.TextContent | types.ImageContent | types.ResourceLink


class Shown(NamedTuple):
    """One value, prepared for a result."""

    blocks: list[Block]
    plain: Any
    """The value, without images; a summary if it is too long."""
    whole: bool
    untrusted: bool


def show(
    plain: Any,
    path: str,
    *,
    budget: int,
    image: int,
    view: View,
    pose: dict[str, Any] | None = None,
) -> Shown:
    """Prepare a plain value with about `budget` tokens and images of up to `image` bytes.

    `pose` is where the robot was, for maps.
    """
    rest, pictures, whole = condensed(plain, view, pose)
    if size(rest) > budget * PER_TOKEN:
        rest, whole = cut(rest, budget), False
    untrusted = speaks(rest)
    blocks: list[Block] = [text(rest, path, untrusted=untrusted)]
    for picture in pictures:
        if picture.size <= image:
            blocks.append(
                types.ImageContent(
                    type="image",
                    data=picture.data,
                    mime_type=picture.media,
                    _meta={UNTRUSTED: True, "rcp/path": path},
                )
            )
        else:
            whole = False
    if not whole:
        blocks.append(_link(path))
    return Shown(blocks, rest, whole, untrusted)


def text(plain: Any, path: str | None, *, untrusted: bool) -> types.TextContent:
    """Return plain data as text, marked if it contains text from the robot."""
    written = msgspec.json.encode(plain).decode()
    if not untrusted:
        return types.TextContent(type="text", text=written)
    return types.TextContent(type="text", text=marked(written, path), _meta={UNTRUSTED: True})


def _link(path: str) -> types.ResourceLink:
    return types.ResourceLink(
        type="resource_link",
        uri=uri_of(path),
        name=path,
        description="The complete value; the text above is a summary.",
    )
