"""Additions to published schemas for JSON's alternative spellings of numbers."""

from __future__ import annotations

from typing import Any

from rcp_protocol.plain import is_list, is_map
from rcp_protocol.shape import SAFE_INTEGER
from rcp_protocol.types import NONFINITE

__all__ = ["published"]

_SPELLED = {"enum": ["NaN", "Infinity", "-Infinity"]}
_BASE64 = "^([A-Za-z0-9+/]{4})*([A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?$"


def published(node: Any) -> Any:
    """Add the spellings that the wire allows: non-finite and long integers as strings."""
    if is_list(node):
        return [published(item) for item in node]
    if not is_map(node):
        return node
    out = {
        key: item if key in ("default", "examples", "enum", "const") else published(item)
        for key, item in node.items()
        if key != NONFINITE
    }
    if node.get("contentEncoding") == "base64":
        out["pattern"] = _BASE64
    kept = {key: out.pop(key) for key in ("unit", "description", "default") if key in out}
    if node.get("type") == "number" and node.get(NONFINITE):
        return {**kept, "anyOf": [out, _SPELLED]}
    if node.get("type") == "integer" and _is_wide(node):
        return {**kept, "anyOf": [_narrowed(out), _digits(node)]}
    return {**out, **kept}


def _narrowed(node: dict[str, Any]) -> dict[str, Any]:
    """Restrict a wide integer to the range that JSON carries exactly; others are strings."""
    out = dict(node)
    for side, limit in (("inimum", -SAFE_INTEGER), ("aximum", SAFE_INTEGER)):
        own = out.get("m" + side, out.get("exclusiveM" + side))
        if own is None or abs(own) > SAFE_INTEGER:
            out.pop("exclusiveM" + side, None)
            out["m" + side] = limit
    return out


def _digits(node: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a wide integer as a string; its pattern only approximates the bounds."""
    low = node.get("minimum", node.get("exclusiveMinimum", -(2**63)))
    high = node.get("maximum", node.get("exclusiveMaximum", 2**63 - 1))
    sign, longest = "-?" if low < 0 else "", len(str(max(abs(low), abs(high))))
    return {"type": "string", "pattern": f"^{sign}[0-9]{{1,{longest}}}$"}


def _is_wide(node: dict[str, Any]) -> bool:
    low = node.get("minimum", node.get("exclusiveMinimum"))
    high = node.get("maximum", node.get("exclusiveMaximum"))
    return low is None or high is None or low < -SAFE_INTEGER or high > SAFE_INTEGER
