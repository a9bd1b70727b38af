"""What msgspec says of a value that it refuses: a text, and nothing else, so it is read here alone.

`tests/test_private_apis.py` holds the texts against the versions that are allowed.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import msgspec

__all__ = ["Fault", "fault_of"]

_WHOLE = re.compile(r"(?s)(?P<what>.*?)(?: - at (?P<key>`key` in )?`\$(?P<place>[^`]*)`)?\Z")
_BOUND = re.compile(r"Expected `\w+` (>=|<=|>|<) (\S+)\Z")
_LACKING = re.compile(r"Object missing required field `(.+)`\Z", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`\Z", re.DOTALL)


class Fault(NamedTuple):
    """Why a value does not fit its type."""

    what: str
    """The fault, without its place."""
    place: str
    """As msgspec writes it: `.a[0].b`, `[...]` for a key that it does not name; empty for the value itself."""
    in_key: bool
    """It is not the value at the place that does not fit, but a key in it."""
    bound: tuple[str, str] | None
    """The comparison that does not hold, and the bound."""
    missing: str | None
    """The field that is required."""
    unknown: str | None
    """The field that is not known."""


def fault_of(error: msgspec.ValidationError) -> Fault:
    """Read what an error says."""
    whole = _WHOLE.match(str(error))
    assert whole  # it matches any text
    what = whole["what"]
    bound, lacking, unknown = (one.match(what) for one in (_BOUND, _LACKING, _UNKNOWN))
    return Fault(
        what,
        whole["place"] or "",
        whole["key"] is not None,
        (bound[1], bound[2].removesuffix(".0")) if bound else None,
        lacking[1] if lacking else None,
        unknown[1] if unknown else None,
    )
