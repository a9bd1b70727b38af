"""`move_to` of a differential drive: it has arrived when measured at the goal, at rest."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable

import anyio

from rcp_can.axis import Axis
from rcp_can.axle import Axle
from rcp_can.goal_control import Goal, GoalControl, Phase
from rcp_can.odometry import Odometry
from rcp_can.standstill import rested
from rcp_can.together import together
from rcp_kernel.errors import DeviceRejected, RcpError
from rcp_kernel.spi import Progress, fenced_off
from rcp_profiles.messages import MoveFeedback, MoveTo

__all__ = ["BaseMove"]

_FEEDBACK = 0.1  # s between two reports
_HEADING = 0.05  # rad of heading error at the goal
_TOLERANCE = 0.05  # m
_TURN = 1.5  # rad/s, the maximum on the spot, so that the load does not slip
_ACCELERATION = 0.5  # m/s² planned for a drive without its own limit
_STUCK = 5.0  # s without progress
_PROGRESS = 0.005  # m, or rad while it turns
_ATTEMPTS = 4  # times that it may come to rest off the goal


class BaseMove:
    """One run of `move_to`."""

    def __init__(
        self, name: str, axle: Axle, odometry: Odometry, track: float, period: float
    ) -> None:
        self._name, self._axle, self._odometry = name, axle, odometry
        self._track, self._period = track, period
        self._ended: RcpError | None = None

    async def run(self, wanted: MoveTo, progress: Progress) -> float:
        """Drive to the goal; return the remaining distance, m, measured at rest.

        :raises DeviceRejected: it makes no progress, or comes to rest elsewhere.
        """
        axle = self._axle
        acceleration = axle.acceleration or _ACCELERATION
        goal = Goal(
            wanted.position.x,
            wanted.position.y,
            wanted.yaw,
            wanted.tolerance or _TOLERANCE,
            _HEADING,
        )
        control = GoalControl(
            goal,
            turn_rate=min(_TURN, axle.top_turn),
            acceleration=acceleration,
            turn_acceleration=2 * acceleration / self._track,
        )
        axle.check(self._name)
        try:
            for _ in range(_ATTEMPTS):
                await self._approach(control, lambda: self._speed(wanted), progress)
                if control.reached(self._odometry.place):
                    return control.distance(self._odometry.place)
                control.again(self._odometry.place)
        except (asyncio.CancelledError, RcpError) as error:
            await self._abandon(error)
            raise
        finally:
            if axle.owner == self._name:
                axle.release()
        await self._abandon(None)
        left = control.distance(self._odometry.place)
        raise DeviceRejected(f"it came to rest {left:.3f} m from the goal, {_ATTEMPTS} times")

    def _speed(self, wanted: MoveTo) -> float:
        axle = self._axle
        return min(wanted.speed or axle.top_speed, axle.speed_limit, axle.top_speed)

    async def _approach(
        self, control: GoalControl, speed: Callable[[], float], progress: Progress
    ) -> None:
        """Drive until the plan ends, and wait until rest is measured."""
        began = control.distance(self._odometry.place)
        stall, reported_at = _Stall(), -math.inf
        while control.phase != "done":
            place, now = self._odometry.place, time.monotonic()
            left, limit = control.distance(place), speed()
            forward, turn = control.step(place, limit)
            self._axle.drive(forward, turn, self._name, self._end)
            waits = not limit and control.phase == "driving"
            if stall.lasts(control.phase, control.remaining(place), now, waits=waits):
                raise DeviceRejected(f"it makes no progress, {left:.3f} m from the goal")
            if now - reported_at >= _FEEDBACK:
                reported_at = now
                feedback = MoveFeedback(left, control.time_left(place, limit))
                progress(feedback, fraction=max(0.0, 1 - left / began) if began else 1.0)
            await asyncio.sleep(self._period)
            self._check()
        self._axle.drive(0.0, 0.0, self._name, self._end)
        await together(rested(wheel) for wheel in self._axle.wheels)
        self._check()

    def _is_driven(self) -> bool:
        """Return whether another command drives the wheels, which were to come to rest."""
        return any(wheel.driven for wheel in self._axle.wheels)

    def _end(self, lost: Axis, reason: RcpError) -> None:
        self._ended = reason

    def _check(self) -> None:
        if self._ended is not None:
            raise self._ended

    async def _abandon(self, why: BaseException | None) -> None:
        """Bring the wheels to rest, unless a stop or a new command controls them.

        :raises RcpError: the move was cancelled, and a wheel is not confirmed to be at rest.
        """
        cancelled = isinstance(why, asyncio.CancelledError)
        if fenced_off() or (self._ended is not None and not cancelled):
            return
        wheels = self._axle.wheels
        try:
            with anyio.CancelScope(shield=True):
                if self._ended is None:  # otherwise, what ended it is stopping them
                    self._axle.rest()
                for wheel in wheels:
                    wheel.leaving = True
                await together(rested(wheel, self._is_driven) for wheel in wheels)
        except RcpError:
            for wheel in wheels:
                wheel.stop()
            if cancelled:
                raise
        finally:
            for wheel in wheels:
                wheel.leaving = False


class _Stall:
    """Whether the present phase of a move has made no progress for too long."""

    def __init__(self) -> None:
        self._phase: Phase = "done"
        self._best, self._improved_at = math.inf, -math.inf

    def lasts(self, phase: Phase, remaining: float, now: float, *, waits: bool) -> bool:
        """Take what remains of a phase; `waits` if it is not meant to move."""
        if waits or phase != self._phase or remaining < self._best - _PROGRESS:
            self._phase, self._best, self._improved_at = phase, remaining, now
        return now - self._improved_at > _STUCK
