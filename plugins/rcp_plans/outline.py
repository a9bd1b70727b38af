"""The audit record of a plan: its steps and their outcome, without values.

A step is a request of its own, so its values are in the records of its own path and tenant.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rcp_kernel.wire import NO_BODY
from rcp_protocol.plain import is_map

__all__ = ["outline"]

_TOLD = ("step", "do", "path", "state", "command")


def outline(report: Any) -> list[dict[str, Any]] | None:
    """Return the outline of a plan's report; None if there is none."""
    if report is NO_BODY:
        return None
    steps: Any = report.get("steps") if is_map(report) else report.steps
    return None if steps is None else [_step(one) for one in steps]


def _step(state: Any) -> dict[str, Any]:
    """Return the outline of a step, without converting its values to plain data first."""
    read: Callable[[str], Any] = state.get if is_map(state) else partial(getattr, state)
    facts = {key: value for key in _TOLD if (value := read(key)) is not None}
    error = read("error")
    return facts if error is None else {**facts, "code": error["code"]}
