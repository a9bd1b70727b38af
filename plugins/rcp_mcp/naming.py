"""How paths of the tree are called in MCP: names of tools and URIs of resources.

Both depend on the path (and the tenant that the caller acts in) alone, so they stay the same
whatever else there is.
"""

from __future__ import annotations

import hashlib
import re

from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import parse_path

__all__ = ["SCHEME", "path_of", "tool_name", "uri_of"]

SCHEME = "rcp://"
_PLAIN = re.compile(r"[A-Za-z0-9_]+\Z")
_LONGEST = 64  # some models take no longer names of tools
_OTHER = re.compile(r"[^A-Za-z0-9_]")


def tool_name(path: str, tenant: str | None) -> str:
    """Name the tool of an action or service: `/action/move_to` is `action-move_to`.

    Segments with dots or dashes, and long paths, end in a hash instead: no two paths are named
    alike. Letters, digits, `_` and `-` are what every model takes.
    """
    own = f"/tenant/{tenant}/"
    short = path[len(own) :] if tenant is not None and path.startswith(own) else path[1:]
    segments = short.split("/")
    name = "-".join(segments)
    if len(name) <= _LONGEST and all(map(_PLAIN.match, segments)):
        return name
    digest = hashlib.sha256(path.encode()).hexdigest()[:10]
    head = "-".join(_OTHER.sub("_", segment) for segment in segments)
    return f"{head[: _LONGEST - 12]}--{digest}"


def uri_of(path: str) -> str:
    """Return the URI of a full path: `rcp://alpha/sensor/pose`, `rcp:///system/status`."""
    return SCHEME + path.removeprefix("/tenant/")


def path_of(uri: str) -> str | None:
    """Return the full path that a URI means, or None if it is not one of ours."""
    if not uri.startswith(SCHEME):
        return None
    rest = uri[len(SCHEME) :]
    text = rest if rest.startswith("/") else f"/tenant/{rest}"
    try:
        return parse_path(text, None)
    except InvalidPath:
        return None
