"""What the record of a plan holds: its steps and what became of them, without their values.

A step is a request of its own, so its values are in the records of its own path and tenant.
"""

from __future__ import annotations

from typing import Any

from rcp_kernel.values import to_plain
from rcp_kernel.wire import NO_BODY

__all__ = ["outline"]

_TOLD = ("step", "do", "path", "state", "command")


def outline(report: Any) -> list[dict[str, Any]] | None:
    """Return the outline of a plan's report; None if there is none."""
    plain: Any = None if report is NO_BODY else to_plain(report)
    steps: Any = None if plain is None else plain.get("steps")
    return None if steps is None else [_step(one) for one in steps]


def _step(state: dict[str, Any]) -> dict[str, Any]:
    told = {key: state[key] for key in _TOLD if key in state}
    error = state.get("error")
    return told if error is None else {**told, "code": error["code"]}
