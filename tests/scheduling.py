"""What runs beside what, where tests run in several processes."""

from __future__ import annotations

from typing import Any

from xdist.scheduler.loadscope import LoadScopeScheduling

__all__ = ["PROCESSES", "Scheduling"]

PROCESSES = 2
"""For each core, of which about half wait for simulated time."""
_WAITING = ("tests/backends/mavlink/", "tests/backends/can/", "tests/backends/ros2/")


class Scheduling(LoadScopeScheduling):
    """A file's functions, or a class, in one process; all that needs a browser in one too.

    Robots take their time and little of the processor, the rest computes: half of the processes begin
    with the one, half with the other, so that the cores are neither idle nor fought for.
    """

    def _split_scope(self, nodeid: str) -> str:
        return "browser" if nodeid.startswith("tests/browser/") else super()._split_scope(nodeid)

    def _assign_work_unit(self, node: Any) -> None:
        waits = list(self.assigned_work).index(node) % 2 == 1
        wanted = (each for each in self.workqueue if each.startswith(_WAITING) is waits)
        chosen = next(wanted, None)
        if chosen is not None:
            self.workqueue.move_to_end(chosen, last=False)
        super()._assign_work_unit(node)
