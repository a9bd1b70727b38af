"""Parsing of plans in any notation."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from rcp_protocol.errors import BadRequest
from rcp_protocol.values import Encoding, parse

__all__ = ["plan_of"]

_SYMBOLIC = re.compile(r"\s*(?:;[^\n]*\n\s*)*(?:[\d.]+\s*:\s*)?\(")
_WHOLE = re.compile(r"\s*[{\[]")


def plan_of(given: str | Sequence[Mapping[str, Any]] | Mapping[str, Any]) -> dict[str, Any]:
    """Return the body of a plan, given as steps, as a complete body, or as text.

    A text is JSON (steps, or a complete body), the output of a planner, or command lines.

    :raises BadRequest: the text begins like JSON but is invalid.
    """
    if isinstance(given, Mapping):
        return dict(given)
    if not isinstance(given, str):
        return {"steps": list(given)}
    if _SYMBOLIC.match(given):
        return {"symbolic": given}
    if not _WHOLE.match(given):
        return {"lines": given}
    found = parse(given.encode(), Encoding.JSON)
    if isinstance(found, list):
        return {"steps": found}
    if isinstance(found, dict):
        return {str(key): item for key, item in found.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    raise BadRequest("a JSON plan must be an object or a list of steps")
