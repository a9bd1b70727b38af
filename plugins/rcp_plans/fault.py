"""Faults of a plan: all of them, each with its step."""

from __future__ import annotations

from typing import Any, NamedTuple

from rcp_kernel.errors import RcpError

__all__ = ["Fault", "refusal"]

_TOLD = 100  # faults listed in an error


class Fault(NamedTuple):
    """One fault."""

    step: str
    """Id of the step, or the line that contains it."""
    error: RcpError

    def plain(self) -> dict[str, Any]:
        """Return the fault as plain data."""
        error = self.error
        facts = {
            "step": self.step,
            "code": error.code,
            "message": error.message,
            "path": error.path,
            "remedy": error.remedy,
            "details": error.details,
        }
        return {key: fact for key, fact in facts.items() if fact is not None}


def refusal(faults: list[Fault]) -> RcpError:
    """Return one error for all faults, with the code of the first."""
    first = faults[0]
    count = f"{len(faults)} faults; the first is" if len(faults) > 1 else "a fault"
    details: dict[str, Any] = {"faults": [fault.plain() for fault in faults[:_TOLD]]}
    if len(faults) > _TOLD:
        details |= {"truncated": True, "count": len(faults)}
    return type(first.error)(
        f"the plan has {count} in step '{first.step}': {first.error.message}",
        path=first.error.path,
        remedy="Correct the faults in `details.faults` and send the plan again; nothing was "
        "started.",
        retry_after=first.error.retry_after,
        details=details,
    )
