"""Conditions: CEL expressions over the values of robots, with bounded evaluation cost."""

from __future__ import annotations

from rcp_conditions.condition import (
    CLOCK,
    Condition,
    ConditionsMissing,
    ConditionTooCostly,
    Ref,
    condition,
)
from rcp_conditions.cost import size_of

__all__ = [
    "CLOCK",
    "Condition",
    "ConditionTooCostly",
    "ConditionsMissing",
    "Ref",
    "condition",
    "size_of",
]
