"""Progress reports and checks while joints move."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from rcp_can.axis import Axis
from rcp_can.trajectory import Trajectory
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.spi import Progress
from rcp_profiles.messages import MoveJointsFeedback, TrajectoryFeedback

__all__ = ["MoveWatch", "TrajectoryWatch"]

_FEEDBACK = 0.1  # s between two reports
_SPAN = 0.1  # s of delay allowed for a drive and its report, besides two periods of its feedback
Positions = Callable[[], dict[str, float]]


class MoveWatch:
    """Reports the remaining distance of the joints."""

    def __init__(
        self,
        goals: Mapping[Axis, float],
        part: Callable[[], float],
        positions: Positions,
        progress: Progress,
    ) -> None:
        self._goals, self._part = goals, part
        self._positions, self._progress = positions, progress
        self._reported_at = float("-inf")

    def __call__(self) -> None:
        """Report, if a report is due."""
        now = time.monotonic()
        if now - self._reported_at < _FEEDBACK:
            return
        self._reported_at = now
        left = max(abs(goal - (axis.position or 0.0)) for axis, goal in self._goals.items())
        self._progress(MoveJointsFeedback(self._positions(), left), fraction=self._part())


class TrajectoryWatch:
    """Reports a trajectory, and aborts it if a joint deviates from it."""

    def __init__(
        self,
        axes: Sequence[Axis],
        line: Trajectory,
        tolerance: float,
        positions: Positions,
        progress: Progress,
    ) -> None:
        self._wakes = {
            axis: _Wake(_SPAN + 2 * (axis.drive.period("position") or 0.0)) for axis in axes
        }
        self._line, self._tolerance = line, tolerance
        self._positions, self._progress = positions, progress
        self._reported_at = float("-inf")

    def __call__(self) -> None:
        """Compare the commanded with the measured position.

        :raises DeviceRejected: a joint is too far from its trajectory; it has been stopped.
        """
        now, worst = time.monotonic(), 0.0
        for axis, wake in self._wakes.items():
            wake.add(now, axis.ramp.position)
            off = wake.off(axis)
            worst = max(worst, off)
            if off > self._tolerance:
                axis.stop()
                raise DeviceRejected(
                    f"joint '{axis.name}' is {off:.3g} rad off its trajectory, more than "
                    f"{self._tolerance:g} rad",
                    details={"joint": axis.name},
                )
        if now - self._reported_at >= _FEEDBACK:
            self._reported_at = now
            elapsed = self._line.elapsed
            feedback = TrajectoryFeedback(elapsed, self._positions(), worst)
            self._progress(feedback, fraction=elapsed / self._line.duration)


class _Wake:
    """The last set-points, because feedback and the drive itself are delayed."""

    def __init__(self, span: float) -> None:
        self._span = span
        self._past: deque[tuple[float, float]] = deque()
        self._reports, self._off = 0, 0.0

    def add(self, now: float, position: float) -> None:
        self._past.append((now, position))
        while now - self._past[0][0] > self._span:
            self._past.popleft()

    def off(self, axis: Axis) -> float:
        """Return the distance of the last reported position from all recent set-points."""
        reports, position = axis.status.counts["position"], axis.position
        if reports != self._reports and position is not None:  # an old report proves nothing
            self._reports = reports
            wanted = [each for _, each in self._past]
            self._off = max(0.0, min(wanted) - position, position - max(wanted))
        return self._off
