"""Rise time, overshoot and settling time of a measured step response."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["StepFigures", "step_figures"]

_LOW, _HIGH = 0.1, 0.9
_BAND = 0.02  # of the way: the usual band of a settling time
_TAIL = 10  # the last value is the mean of the last tenth of the samples
_RESPONSE = 0.1  # of the amplitude: a joint that moves less has not responded
_FEWEST = 5  # samples


class StepFigures(NamedTuple):
    """The figures of a step response; None where there is none."""

    rise_time: float | None = None
    overshoot: float | None = None
    settling_time: float | None = None


def step_figures(times: Sequence[float], values: Sequence[float], amplitude: float) -> StepFigures:
    """Compute the figures of a step at time zero; s, and parts of the way to the last value."""
    if len(values) < _FEWEST:
        return StepFigures()
    tail = values[-max(1, len(values) // _TAIL) :]
    first, last = values[0], sum(tail) / len(tail)
    way = last - first
    if abs(way) < _RESPONSE * abs(amplitude):
        return StepFigures()
    parts = [(value - first) / way for value in values]
    low, high = _crossing(times, parts, _LOW), _crossing(times, parts, _HIGH)
    rise = None if low is None or high is None else high - low
    outside = [n for n, part in enumerate(parts) if abs(part - 1) > _BAND]
    settled = outside[-1] + 1 if outside else 0
    within_tail = settled <= len(parts) - len(tail)
    return StepFigures(rise, max(0.0, max(parts) - 1), times[settled] if within_tail else None)


def _crossing(times: Sequence[float], parts: Sequence[float], level: float) -> float | None:
    """Return when a level is first reached, by linear interpolation."""
    for n in range(1, len(parts)):
        before, after = parts[n - 1], parts[n]
        if before < level <= after:
            return times[n - 1] + (times[n] - times[n - 1]) * (level - before) / (after - before)
    return None
