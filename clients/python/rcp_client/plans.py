"""Plans as a caller gives them, in the notation that they are written in."""

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
    """Return the body of a plan: of steps, of a whole body, or of a text in any notation.

    A text is JSON (steps, or a whole body), what a planner prints, or lines of commands.

    :raises BadRequest: the text begins like JSON and is none.
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
