"""Step response and chirp of a motor, within its limits, ending at rest."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from rcp_can.axis import Axis
from rcp_can.chirp_signal import ChirpSignal
from rcp_can.excitation_messages import (
    Chirp,
    Excitation,
    ExcitationFeedback,
    Response,
    Step,
    StepResponse,
)
from rcp_can.procedure import Procedure
from rcp_can.standstill import rested
from rcp_can.step_figures import step_figures
from rcp_kernel.errors import InvalidValue, OutOfRange
from rcp_kernel.spi import Progress

__all__ = ["excitations"]

_POLL_PERIOD = 0.002  # s between two looks for a new report
_FEEDBACK = 0.1  # s between two progress reports
_SAMPLES = 2000  # samples of one response, at most
_PER_TURN = 8  # set-points in a period of a chirp's highest frequency, at least
_LATE = 1.5  # periods that a chirp may go on at once, however late a set-point is
_TIMEOUT = 60.0  # s
_NEEDED = "position", "velocity"


def excitations(axis: Axis) -> list[Procedure]:
    """List the measurements of a motor."""
    known = [mode for mode in _NEEDED if mode in axis.drive.modes]
    if not known or not axis.drive.places:  # a response has both
        return []
    small = {"velocity": round(0.1 * axis.velocity_limit, 4)}
    runs = _Excitations(axis)
    return [
        Procedure(
            "step",
            "Measure the response to one step of position or velocity; ends at rest.",
            runs.step,
            needs="enabled",
            motion="set_points",
            input=Step,
            output=StepResponse,
            feedback=ExcitationFeedback,
            examples=({**small, "duration": 0.5},),
            timeout=_TIMEOUT,
            check=runs.check_step,
        ),
        Procedure(
            "chirp",
            "Measure the response to a sine of changing frequency; ends at rest.",
            runs.chirp,
            needs="enabled",
            motion="set_points",
            input=Chirp,
            output=Response,
            feedback=ExcitationFeedback,
            examples=({**small, "duration": 2.0, "start_frequency": 1.0, "end_frequency": 2.0},),
            timeout=_TIMEOUT,
            check=runs.check_chirp,
        ),
    ]


class _Goal(NamedTuple):
    """Mode, amplitude, and the value from which it is counted."""

    mode: Literal["position", "velocity"]
    amplitude: float
    base: float


class _Excitations:
    """The measurements of one motor."""

    def __init__(self, axis: Axis) -> None:
        self._axis = axis

    # Checks

    def check_step(self, step: Step) -> None:
        """Check that a step stays within the limits, with the way it needs to brake.

        :raises RcpError: it does not.
        """
        goal = self._goal(step)
        if goal.mode == "velocity":
            braking = goal.amplitude * abs(goal.amplitude) / 2 / (self._acceleration or 1e9)
            self._check_place(goal.amplitude * step.duration + braking, "velocity")
        else:
            self._check_place(goal.amplitude, "position")

    def check_chirp(self, chirp: Chirp) -> None:
        """Check that position, velocity and acceleration of a chirp stay within the limits.

        :raises RcpError: they do not.
        """
        axis, goal, signal = self._axis, self._goal(chirp), _signal(chirp)
        size, rate = abs(goal.amplitude), axis.config.rate
        highest = max(chirp.start_frequency, chirp.end_frequency)
        if highest * _PER_TURN > rate:
            raise OutOfRange(
                f"{highest:g} Hz needs {_PER_TURN} set-points in each period, and motor "
                f"'{axis.name}' takes {rate:g} a second",
                details={"pointer": "/end_frequency"},
                remedy=f"Stay below {rate / _PER_TURN:g} Hz, or set a higher `rate` of the motor.",
            )
        slopes = signal.slope, signal.curvature
        speed, bend = (
            (size, size * slopes[0])
            if goal.mode == "velocity"
            else (
                size * slopes[0],
                size * slopes[1],
            )
        )
        if speed > axis.velocity_limit:
            raise _beyond(goal.mode, "velocity", speed, axis.velocity_limit, "rad/s")
        if self._acceleration is not None and bend > self._acceleration:
            raise _beyond(goal.mode, "acceleration", bend, self._acceleration, "rad/s²")
        way = size if goal.mode == "position" else size * signal.integral
        for each in (way, -way):
            self._check_place(each, goal.mode)

    @property
    def _acceleration(self) -> float | None:
        return self._axis.config.acceleration

    def _goal(self, wanted: Excitation) -> _Goal:
        axis = self._axis
        if (wanted.position is None) == (wanted.velocity is None):
            raise InvalidValue(
                "give either `position` or `velocity`", details={"pointer": "/position"}
            )
        if wanted.velocity is not None:
            mode, amplitude, base = "velocity", wanted.velocity, 0.0
        else:
            held = axis.mode == "position" and axis.resting
            here = axis.ramp.position if held else axis.position
            mode, amplitude, base = "position", wanted.position or 0.0, here or 0.0
        if mode not in axis.drive.modes:
            raise InvalidValue(
                f"motor '{axis.name}' takes no {mode}", details={"pointer": f"/{mode}"}
            )
        if not amplitude:
            raise InvalidValue("the amplitude is zero", details={"pointer": f"/{mode}"})
        if mode == "velocity" and abs(amplitude) > axis.velocity_limit:
            raise _beyond(mode, "velocity", abs(amplitude), axis.velocity_limit, "rad/s")
        return _Goal(mode, amplitude, base)

    def _check_place(self, way: float, field: str) -> None:
        axis = self._axis
        here = axis.position
        if axis.config.position is None and field == "velocity":
            return
        if here is not None and not axis.low <= here + way <= axis.high:
            raise OutOfRange(
                f"parameter '{field}' exceeds allowed range: motor '{axis.name}' would go to "
                f"{here + way:.4g} rad, which is not within {axis.low:g} and {axis.high:g} rad",
                details={"pointer": f"/{field}"},
            )

    # Runs

    async def step(self, step: Step, progress: Progress) -> StepResponse:
        """Command the step, and come to rest afterwards."""
        axis, goal = self._axis, self._goal(step)
        record = await self._run(
            goal,
            step.duration,
            progress,
            lambda: axis.command(goal.mode, goal.base + goal.amplitude),
        )
        found = step_figures(record.time, record.measured(goal.mode), goal.amplitude)
        return StepResponse(**record.lists(goal.mode), **found._asdict())

    async def chirp(self, chirp: Chirp, progress: Progress) -> Response:
        """Command the chirp, and come to rest afterwards."""
        axis, goal, signal = self._axis, self._goal(chirp), _signal(chirp)
        clock = _BoundedClock(_LATE / axis.config.rate)

        def path() -> tuple[float, float]:
            value, slope = signal.at(clock.now())
            if goal.mode == "velocity":
                return goal.base, goal.amplitude * value
            return goal.base + goal.amplitude * value, goal.amplitude * slope

        record = await self._run(
            goal, chirp.duration, progress, lambda: axis.command(goal.mode, goal.base, path)
        )
        return Response(**record.lists(goal.mode))

    async def _run(
        self, goal: _Goal, duration: float, progress: Progress, begin: Callable[[], None]
    ) -> _Record:
        axis = self._axis
        record = _Record(axis, duration / _SAMPLES)
        record.take()
        begin()
        told = 0.0
        while (now := record.elapsed) < duration:
            await asyncio.sleep(_POLL_PERIOD)
            record.take()
            if now - told >= _FEEDBACK:
                told = now
                feedback = ExcitationFeedback(time=now, position=axis.position)
                progress(feedback, fraction=min(1.0, now / duration))
        if goal.mode == "velocity":
            axis.rest()
        await rested(axis)
        return record


class _BoundedClock:
    """The time since its first reading, which goes on by no more than a bound at once; s."""

    def __init__(self, longest: float) -> None:
        self._longest, self._time = longest, 0.0
        self._last: float | None = None

    def now(self) -> float:
        """Return the time."""
        now = time.monotonic()
        if self._last is not None:
            self._time += min(now - self._last, self._longest)
        self._last = now
        return self._time


class _Record:
    """The reports of a drive, with what was commanded when each was taken."""

    def __init__(self, axis: Axis, spacing: float) -> None:
        self._axis, self._spacing, self._began = axis, spacing, time.monotonic()
        self._seen = -1
        self.time: list[float] = []
        self._position: list[float] = []
        self._velocity: list[float] = []
        self._commanded: dict[str, list[float]] = {"position": [], "velocity": []}

    @property
    def elapsed(self) -> float:
        """The time since it was begun, s."""
        return time.monotonic() - self._began

    def take(self) -> None:
        """Take the last report, if it is new."""
        axis, status = self._axis, self._axis.status
        position, velocity = axis.position, axis.velocity
        if status.moved == self._seen or position is None or velocity is None:
            return
        received = max(0.0, status.received_at["position"] - self._began)
        if self.time and received < self.time[-1] + self._spacing:
            return
        self._seen = status.moved
        self.time.append(received)
        self._position.append(position)
        self._velocity.append(velocity)
        self._commanded["position"].append(axis.ramp.position)
        self._commanded["velocity"].append(axis.ramp.velocity)

    def measured(self, mode: str) -> list[float]:
        """Return what was measured of the commanded quantity."""
        return self._position if mode == "position" else self._velocity

    def lists(self, mode: str) -> dict[str, Any]:
        """Return the fields of a response."""
        return {
            "time": self.time,
            "position": self._position,
            "velocity": self._velocity,
            f"commanded_{mode}": self._commanded[mode],
        }


def _signal(chirp: Chirp) -> ChirpSignal:
    return ChirpSignal(chirp.start_frequency, chirp.end_frequency, chirp.duration)


def _beyond(field: str, what: str, value: float, limit: float, unit: str) -> OutOfRange:
    return OutOfRange(
        f"parameter '{field}' exceeds allowed range: it needs {what} {value:.4g} {unit}, and "
        f"{limit:g} {unit} are allowed",
        details={"pointer": f"/{field}"},
    )
