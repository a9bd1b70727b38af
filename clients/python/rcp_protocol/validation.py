"""Parser of msgspec's validation messages, which have no structured form.

`tests/test_private_apis.py` checks the message texts of the supported versions.
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
    """The fault, without its location."""
    place: str
    """Location as msgspec writes it: `.a[0].b`, `[...]` for an unnamed key; empty for the value
    itself."""
    in_key: bool
    """Whether a key at the location is invalid, rather than its value."""
    bound: tuple[str, str] | None
    """The violated comparison and its bound."""
    missing: str | None
    """The missing required field."""
    unknown: str | None
    """The unknown field."""


def fault_of(error: msgspec.ValidationError) -> Fault:
    """Parse a validation error."""
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
