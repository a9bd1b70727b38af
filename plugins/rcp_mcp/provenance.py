"""Descriptions and units that come from robots, marked as data in lists and results.

A plugin takes them from the robot where it can: parameters of a ROS node have descriptions and units of
their own. So every text of a resource below `/tenant/` counts as the robot's, and of `/system/` as
the gateway's. Lists have one mark for a run of the gateway, so that they stay the same from call to
call; it is taken out of any text that contains it.
"""

from __future__ import annotations

from typing import Any

from rcp_protocol.plain import is_list, is_map
from rcp_web.untrusted import TextMarker, speaks

__all__ = ["Marker", "is_own"]

_TEXTS = frozenset(("description", "title"))
_FREE = frozenset(("$ref", "$id", "pattern", "format", "type", "contentEncoding"))
"""Keys whose text the gateway writes."""
_VALUES = frozenset(("enum", "const", "default", "examples", "required"))
"""Keys whose content is values and not schemas."""


def is_own(path: str) -> bool:
    """Return whether a resource is the gateway's own."""
    return path.startswith("/system/")


class Marker(TextMarker):
    """Marks descriptions, units and schemas."""

    def schema(self, node: Any) -> Any:
        """Mark the texts in a schema.

        Where marks would change its meaning (names, constants, examples), what speaks is left out:
        `discover` returns the whole schema as marked data.
        """
        if is_list(node):
            return [self.schema(item) for item in node]
        if not is_map(node):
            return node
        out: dict[str, Any] = {}
        for key, item in node.items():
            if key in _TEXTS and isinstance(item, str):
                out[key] = self.text(item)
            elif key in ("properties", "$defs"):
                kept = {name: one for name, one in item.items() if not speaks(name)}
                out[key] = {name: self.schema(one) for name, one in kept.items()}
                if len(kept) < len(item):
                    out["additionalProperties"] = True
            elif key in _FREE or not speaks(item):
                out[key] = item
            elif key not in _VALUES and (is_map(item) or is_list(item)):
                out[key] = self.schema(item)
        return out
