"""Names of ROS 2 and paths of the tree: patterns, translation and hidden names."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Container, Iterable

__all__ = ["absolute", "allows", "is_internal", "is_internal_parameter", "legal", "resource_name"]

_PLUMBING = re.compile(
    r"/(_.*|.*/_.*|rosout|parameter_events|.*/(describe_parameters|get_parameters"
    r"|get_parameter_types|list_parameters|set_parameters|set_parameters_atomically"
    r"|get_type_description|get_logger_levels|set_logger_levels))\Z"
)
_HIDDEN_PARAMETERS = ("qos_overrides.", "start_type_description_service")
_NOT_A_SEGMENT = re.compile(r"[^A-Za-z0-9_.-]+")
_LONGEST = 200  # characters of a text kept in a path


def absolute(name: str, namespace: str = "/") -> str:
    """Return the absolute form of a ROS name."""
    if name.startswith("/"):
        return name
    return f"{namespace.rstrip('/')}/{name}"


def allows(patterns: Iterable[str]) -> Callable[[str], bool]:
    """Compile name patterns, in which `*` is one segment and `**` any number."""
    found = [re.compile(_expression(pattern)).match for pattern in patterns]
    return lambda name: any(match(name) for match in found)


def _expression(pattern: str) -> str:
    def part(segment: str) -> str:
        if segment == "**":
            return r"(?:/[^/]+)*"
        return "/" + re.escape(segment).replace(r"\*", "[^/]*")

    return "".join(part(s) for s in pattern.strip("/").split("/")) + r"\Z"


def is_internal(name: str) -> bool:
    """Return whether a topic or service is internal to ROS, or hidden by an underscore."""
    return _PLUMBING.match(name) is not None


def is_internal_parameter(name: str) -> bool:
    """Return whether a parameter is one of those that every ROS node has."""
    return name.startswith(_HIDDEN_PARAMETERS)


def legal(text: str, taken: Container[str] = ()) -> str:
    """Convert a text to path segments; a digest resolves collisions with `taken`."""
    found = [_NOT_A_SEGMENT.sub("_", s).strip("_") for s in text.split("/")]
    short = "/".join(s for s in found if s.strip("."))[:_LONGEST].rstrip("/") or "unnamed"
    return f"{short}-{zlib.crc32(text.encode()):08x}" if short in taken else short


def resource_name(branch: str, *names: str) -> str:
    """Build a resource name from ROS names, which may contain slashes."""
    segments = [s for name in names for s in name.split("/") if s]
    return "/".join([branch, *(_NOT_A_SEGMENT.sub("_", s) for s in segments)])
