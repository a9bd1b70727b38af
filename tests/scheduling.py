"""What runs beside what, where tests run in several processes."""

from __future__ import annotations

from typing import Any

from xdist.scheduler.loadscope import LoadScopeScheduling

__all__ = ["PROCESSES", "Scheduling", "turn"]

PROCESSES = 2
"""For each core, of which about half wait for robots; with three, those that are late fail on a busy machine."""
_LEAST = 2  # tests that a process has to know of
_TOGETHER = {
    "tests/browser/": "browser",
    "tests/docs/test_examples.py": "demo",
    "tests/docs/test_tour.py": "demo",
}
"""Files whose tests share what takes long to start."""
_LONGEST = (
    "tests/browser/",
    "tests/backends/mavlink/test_gateway_gone.py",
    "tests/backends/ros2/test_stop",
    "tests/backends/ros2/test_arm.py",
    "tests/backends/ros2/test_profiles.py",
    "tests/docs/test_examples.py",
    "tests/docs/test_tour.py",
    "tests/patrol/",
    "tests/transports/test_hostile.py",
    "tests/backends/ros2/test_gateway_gone.py",
    "tests/plugins/vda5050/",
    "tests/plugins/guard/",
    "tests/durability/",
    "tests/kernel/process/",
    "tests/backends/fleet/",
    "tests/installed/",
    "tests/plugins/ground_stations/",
    "tests/clients/",
    "tests/test_hangs.py",
)
"""What begins first, in this order: each takes half a minute to ten, and must not be what is waited for."""
_WAITING = ("tests/backends/can/", "tests/backends/ros2/", "tests/backends/mujoco/")


def turn(nodeid: str) -> int:
    """Tell when a test's turn is, by which to sort: what takes longest is not to begin last."""
    places = (place for place, files in enumerate(_LONGEST) if nodeid.startswith(files))
    return next(places, len(_LONGEST))


class Scheduling(LoadScopeScheduling):
    """A file's functions, or a class, in one process; all that needs a browser, or a demo, in one too.

    Robots take their time and little of the processor, the rest computes: half of the processes begin
    with the one, half with the other, so that the cores are neither idle nor fought for.
    """

    def _split_scope(self, nodeid: str) -> str:
        for files, scope in _TOGETHER.items():
            if nodeid.startswith(files):
                return scope
        return super()._split_scope(nodeid)

    def _assign_work_unit(self, node: Any) -> None:
        waits = list(self.assigned_work).index(node) % 2 == 1
        wanted = (each for each in self.workqueue if each.startswith(_WAITING) is waits)
        chosen = next(wanted, None)
        if chosen is not None:
            self.workqueue.move_to_end(chosen, last=False)
        super()._assign_work_unit(node)

    def _reschedule(self, node: Any) -> None:
        """Hand out work; a process runs a test only once it knows the next, so two at least."""
        super()._reschedule(node)
        while (
            self.workqueue
            and not node.shutting_down
            and self._pending_of(self.assigned_work[node]) < _LEAST
        ):
            self._assign_work_unit(node)

    def remove_node(self, node: Any) -> str | None:
        """Give others what a process has left, but for the test under which it ended.

        As it comes, the scheduler would run that test again, in one process after the other until
        none is left, and would hand out what has long been done, on which a process waits for ever.
        """
        units = self.assigned_work.pop(node)
        left = [(unit, test) for unit in units.values() for test, done in unit.items() if not done]
        if not left:
            return None
        unit, crashed = left[0]
        unit[crashed] = True
        self.workqueue.update({k: v for k, v in units.items() if not all(v.values())})
        for other in self.nodes:
            self._reschedule(other)
        return crashed
