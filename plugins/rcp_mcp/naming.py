"""Names of the tree in MCP: tool names and resource URIs.

Both depend only on the path and the caller's tenant, so they do not change with the rest of the
tree.
"""

from __future__ import annotations

import hashlib
import re

from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import parse_path

__all__ = ["SCHEME", "as_path", "path_of", "tool_name", "uri_of"]

SCHEME = "rcp://"
_PLAIN = re.compile(r"[A-Za-z0-9_]+\Z")
_LONGEST = 64  # some models do not accept longer tool names
_OTHER = re.compile(r"[^A-Za-z0-9_]")


def tool_name(path: str, tenant: str | None) -> str:
    """Return the tool name of an action or service: `/action/move_to` is `action-move_to`.

    Paths with dots or dashes in a segment, and long paths, end in a hash instead, so that names are
    unique. Every model accepts letters, digits, `_` and `-`.
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


def as_path(text: str) -> str:
    """Return a path or pattern that may be written as a URI of this server as a path."""
    if not text.startswith(SCHEME):
        return text
    rest = text[len(SCHEME) :]
    return rest if rest.startswith("/") else f"/tenant/{rest}"


def path_of(uri: str) -> str | None:
    """Return the full path of a URI, or None if it does not belong to this server."""
    if not uri.startswith(SCHEME):
        return None
    try:
        return parse_path(as_path(uri), None)
    except InvalidPath:
        return None
