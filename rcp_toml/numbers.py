"""Numbers that TOML can write and no setting can have."""

from __future__ import annotations

import math

__all__ = ["unusable"]

_LARGEST = 2**63 - 1  # what a TOML parser has to read


def unusable(node: object) -> str | None:
    """Return what is wrong with a number, whatever its key; None of anything else.

    An infinite one may be meant: "never".
    """
    if isinstance(node, int) and not -_LARGEST - 1 <= node <= _LARGEST:
        return "is too large: write a whole number of at most 64 bits"
    if isinstance(node, float) and math.isnan(node):
        return "is no number: write one"
    return None
