"""What nodes tell about themselves each second."""

from __future__ import annotations

from typing import Literal

from rcp_can.status import Fault

__all__ = [
    "HEALTH",
    "MODES",
    "OFFLINE",
    "OPERATIONAL",
    "Healthy",
    "NodeMode",
    "Uptime",
    "health_fault",
]

OFFLINE = 3.0  # s without a report, after which a node counts as offline
OPERATIONAL = 0
_SLACK = 0.25  # s that reports may be late
_DRIFT = 1.01  # of the node's clock, at most

Healthy = Literal["ok", "warning", "error", "critical"]
NodeMode = Literal[
    "unknown", "operational", "initialization", "maintenance", "software_update", "offline"
]
HEALTH: tuple[Healthy, ...] = ("ok", "warning", "error", "critical")
MODES: tuple[NodeMode, ...] = (
    "operational", "initialization", "maintenance", "software_update",
    "unknown", "unknown", "unknown", "offline",
)  # fmt: skip


class Uptime:
    """Detects from a node's reports that it has restarted."""

    def __init__(self) -> None:
        self.last: int | None = None
        """The last report, s."""
        self._at = 0.0

    def has_restarted(self, uptime: int, at: float) -> bool:
        """Note a report that was received at a monotonic time; return whether it began anew.

        It did if it counted fewer seconds than have passed, also if a node that was away for long
        has counted more than before.
        """
        before, passed = self.last, at - self._at
        self.last, self._at = uptime, at
        if before is None:
            return False
        counted = uptime - before
        return counted < 0 or passed > (counted + 1 + _SLACK) * _DRIFT


def health_fault(health: int, code: int) -> Fault | None:
    """Return the fault of a node that reports an error; its own code may tell more."""
    word = HEALTH[health]
    if word in ("ok", "warning"):
        return None
    return Fault(f"node_{word}", f"the node reports its health as {word} (code {code})", code)
