"""The resources of a motor: state, commands, and when commands complete."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Container, Coroutine
from typing import Any, TypeVar, cast

import anyio

from rcp_can import motor_messages as m
from rcp_can import views
from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.motor_resources import motor_resources
from rcp_can.power_switch import enable
from rcp_can.preconditions import check, check_feedback, check_link, ready
from rcp_can.standstill import rested
from rcp_kernel.errors import (
    DeviceRejected,
    ModeForbids,
    OutOfRange,
    RcpError,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, fenced_off

__all__ = ["MotorPart", "abandon", "drive_to", "end_own_motion", "released", "unless_lost"]

_T = TypeVar("_T")
_FEEDBACK = 0.1  # s between two progress reports of a move
_SETTLE = 3.0  # s the joint may need to settle after its set-point has arrived
_POLL_PERIOD = 0.01  # s
_ZEROED = "a zero set-point ended the move"


class MotorPart(Part):
    """The resources of one motor."""

    def __init__(self, axis: Axis, shared: Container[str] = ()) -> None:
        """`shared` are the modes of which other motors take set-points in the same cycle."""
        self.axis = axis
        self._prefix = axis.name
        self._shared = shared

    def resources(self) -> list[Resource]:
        """List the resources of a motor, according to its drive."""
        return motor_resources(self.axis, self._shared)

    async def write(self, name: str, value: float) -> None:
        """Set a set-point; zero is accepted also while the motor is off."""
        if self.axis.owner is not None and _is_zero(name, value):
            self.axis.forget(ModeForbids(_ZEROED))
        self.check(name, value)
        self.command(name, value)

    def check(self, name: str, value: float) -> None:
        """Check that a set-point would be accepted now.

        :raises RcpError: the motor is driven by an action, or as `preconditions.check`.
        """
        axis = self.axis
        if _is_zero(name, value):
            check_link(axis)
            if not axis.status.enabled or axis.stopped:
                return
        elif axis.owner is not None:
            raise ModeForbids(
                f"motor '{axis.name}' is driven by {axis.owner}",
                remedy="Cancel that command first.",
            )
        check(axis)

    def command(self, name: str, value: float) -> None:
        """Set a set-point that has been checked."""
        axis, mode = self.axis, cast("m.Mode", name.rpartition("/")[2])
        if _is_zero(name, value):
            if axis.owner is not None:
                axis.forget(ModeForbids(_ZEROED))
            if not axis.status.enabled or axis.stopped:  # and a zero does not end a stop
                return
        axis.command(mode, value)

    async def read(self, name: str) -> Any:
        """Return the last report of the drive, if it is still connected."""
        axis = self.axis
        match name:
            case _ if name.endswith("/state"):
                return views.state(axis)
            case _ if name.endswith("/motion"):
                check_link(axis)
                check_feedback(axis)
                return views.motion(axis)
            case _ if name.endswith("/health"):
                check_link(axis)
                return views.health(axis)
            case _:
                return await super().read(name)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run one of the motor's services or actions."""
        axis = self.axis
        verb = name.rpartition("/")[2]
        if verb != "disable":  # `disable` is sent even to a drive that does not respond
            await ready(axis)
            await released(axis)
        if axis.owner is not None and verb in ("enable", "set_zero", "home", "move_to"):
            raise ModeForbids(f"motor '{axis.name}' is driven by {axis.owner}")
        match verb:
            case "enable":
                await enable(axis)
            case "disable":
                await axis.disable()
            case "clear_faults":
                await axis.clear_faults()
            case "set_zero":
                await self._zero()
            case "home":
                await self._home(progress)
            case "move_to":
                return await self._move(value, name, progress)
            case _:
                return await super().execute(name, value, progress)
        return None

    async def halt(self) -> None:
        """Quick stop; return when fresh feedback shows that it is at rest.

        :raises AdapterUnavailable: it cannot be reached, or has never sent a message.
        :raises DeviceTimeout: it does not come to rest, or its feedback is lost.
        """
        axis = self.axis
        if not axis.met:
            axis.hold_stop()  # the drive may receive frames although its own are lost
            if axis.config.optional:
                return
            check_link(axis)
        reason = ModeForbids(f"motor '{axis.name}' was halted")
        if axis.secure:
            axis.forget(reason)
            return
        axis.stop()
        axis.forget(reason)
        check_link(axis)
        await rested(axis)

    async def hold(self, reason: RcpError) -> None:
        """Decelerate along the ramp and hold with torque on; return when rest is measured.

        :raises RcpError: as for `halt`.
        """
        axis = self.axis
        if not axis.met and axis.config.optional:
            return
        check_link(axis)
        axis.pause(reason)
        await rested(axis)
        if axis.drive.sags and axis.status.enabled and not axis.stopped and axis.mode != "position":
            here = axis.position
            if here is not None and axis.low <= here <= axis.high:
                axis.command("position", here)

    def hold_stop(self) -> None:
        """Repeat the stop if the motor moves."""
        self.axis.hold_stop()

    async def _zero(self) -> None:
        if self.axis.mode is not None and not self.axis.resting:
            raise ModeForbids(
                f"motor '{self.axis.name}' is moving", remedy="Bring it to rest first."
            )
        self.axis.forget(None)
        await rested(self.axis)
        await self.axis.drive.set_zero()

    async def _home(self, progress: Progress) -> None:
        axis = self.axis
        check(axis)
        axis.forget(None)
        axis.owner = f"action/{axis.name}/home"
        try:
            await unless_lost(axis, axis.drive.home(progress))
        except (asyncio.CancelledError, RcpError) as error:
            if axis.drive.busy:  # a set-point of rest would not end that
                await end_own_motion(axis, error)
            else:
                await abandon(axis, error)
            raise
        finally:
            axis.owner = axis.ended = None
            axis.show()

    async def _move(self, move: m.Move, name: str, progress: Progress) -> m.Moved:
        axis = self.axis
        check(axis)
        if not axis.low <= move.position <= axis.high:
            raise OutOfRange(
                f"parameter 'position' exceeds allowed range: {move.position:g} rad is not "
                f"within {axis.low:g} and {axis.high:g} rad",
                details={"pointer": "/position"},
            )
        started = time.monotonic()
        axis.owner = name
        try:
            await drive_to(axis, move, progress)
        except (asyncio.CancelledError, RcpError) as error:
            await abandon(axis, error)
            raise
        finally:
            axis.owner = axis.ended = None
        return m.Moved(position=axis.position or 0.0, duration=time.monotonic() - started)


def _is_zero(name: str, value: float) -> bool:
    """Return whether a set-point brings the motor to rest."""
    return value == 0.0 and not name.endswith("/position")


async def unless_lost(axis: Axis, work: Coroutine[Any, Any, _T]) -> _T:
    """Await an operation of the drive; end it with the reason if the motor becomes unavailable."""
    task = asyncio.ensure_future(work)
    reasons: list[RcpError] = []

    def end(reason: RcpError) -> None:
        reasons.append(reason)
        task.cancel()

    axis.ended = end
    try:
        await asyncio.wait((task,))
    finally:
        axis.ended = None
        while not task.done():
            task.cancel()
            with anyio.CancelScope(shield=True):
                await asyncio.wait((task,), timeout=_POLL_PERIOD)
        if not task.cancelled():
            task.exception()  # retrieved: what ends it here may outweigh that it failed as well
    if reasons:
        raise reasons[0]
    return task.result()


async def drive_to(axis: Axis, move: m.Move, progress: Progress) -> None:
    """Move a joint; return when its drive reports that the goal is reached.

    :raises DeviceRejected: it does not reach its goal.
    """
    lost: list[RcpError] = []
    progress(fraction=0.0)
    tolerance = move.tolerance or axis.config.tolerance
    velocity = min(move.velocity or axis.velocity_limit, axis.velocity_limit)
    start = axis.position or 0.0
    distance = abs(move.position - start)
    own = axis.drive.moves
    acceleration = axis.config.acceleration
    if own:
        axis.forget(None)
        goal = (move.position - axis.config.offset) * axis.ratio
        raw = None if acceleration is None else acceleration * axis.config.gear
        await unless_lost(axis, axis.drive.move(goal, velocity * axis.config.gear, raw))
        axis.ended = lost.append
    else:
        axis.ended = lost.append
        axis.command("position", move.position)
        axis.ramp.limit = velocity
    patience = distance / velocity + _SETTLE
    if acceleration is not None:
        patience += velocity / acceleration
    began = reported_at = time.monotonic()
    reports = axis.status.reports + axis.status.moved
    while True:
        await asyncio.sleep(_POLL_PERIOD)
        if lost:
            raise lost[0]
        now = time.monotonic()
        here = axis.position if axis.position is not None else start
        left = move.position - here
        if now - reported_at >= _FEEDBACK:
            reported_at = now
            part = max(0.0, 1 - abs(left) / distance) if distance else 1.0
            progress(m.MoveFeedback(position=here, left=left), fraction=part)
        fresh = axis.status.reports + axis.status.moved > reports + 1
        there = abs(left) <= tolerance and fresh
        if there and (axis.status.reached if own else axis.resting):
            return
        if now - began > 2 * patience:
            raise DeviceRejected(
                f"motor '{axis.name}' did not come closer than {left:g} rad to its goal"
            )


async def abandon(axis: Axis, why: BaseException) -> None:
    """Bring a joint to rest after its move has ended, unless a stop already controls the drive.

    :raises RcpError: the move was cancelled, and the joint is not confirmed to be at rest.
    """
    axis.ended = None
    if fenced_off():
        return  # the stop controls the drive
    cancelled = isinstance(why, asyncio.CancelledError)
    if cancelled:
        check_link(axis)
        check_feedback(axis)
    if why is axis.gone or axis.stopping or not axis.online or not axis.status.enabled:
        return
    axis.rest()
    axis.leaving = True
    try:
        with anyio.CancelScope(shield=True):
            await rested(axis)
    except RcpError:
        axis.stop()
        if cancelled:
            raise
    finally:
        axis.leaving = False


async def end_own_motion(axis: Axis, why: BaseException) -> None:
    """Stop a drive that moves by itself; return when it is at rest.

    :raises RcpError: the command was cancelled, and rest is not confirmed.
    """
    # A stop that ended it already controls the drive; and it may not have begun to move.
    if not fenced_off() and not axis.resting:
        axis.stop()
    axis.leaving = True
    try:
        with anyio.CancelScope(shield=True):
            await rested(axis)
    except RcpError:
        if isinstance(why, asyncio.CancelledError):
            raise
    finally:
        axis.leaving = False


async def released(axis: Axis) -> None:
    """Wait until an ended action has released the motor."""
    while axis.leaving:  # noqa: ASYNC110  # the task that releases it signals nobody
        await asyncio.sleep(_POLL_PERIOD)
