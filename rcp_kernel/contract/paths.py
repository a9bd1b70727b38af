"""Paths that several parts of the gateway know, and the paths that a record names."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

__all__ = ["ESTOP", "EVERYTHING", "MOST_TOUCHES", "bounded_touches"]

ESTOP = "/system/estop"
"""The e-stop: requests to it are never limited, and its replies are sent whatever else waits."""
EVERYTHING = "/**"
"""Stands for all paths: only readers from whom nothing is hidden may see such a record."""
MOST_TOUCHES = 256
"""Maximum number of further paths of a record; beyond it, the record counts as naming everything."""


def bounded_touches(paths: Iterable[str]) -> tuple[str, ...]:
    """Remove duplicates; return only `EVERYTHING` if there are too many, or it is among them.

    Readers of a record must be allowed to see all of them.
    """
    found = tuple(islice(dict.fromkeys(paths), MOST_TOUCHES + 1))
    return (EVERYTHING,) if len(found) > MOST_TOUCHES or EVERYTHING in found else found
