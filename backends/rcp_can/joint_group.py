"""Joint groups: several motors commanded together, with synchronized moves."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import anyio

from rcp_can import motor_messages as m
from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.config_joints import JointGroupConfig
from rcp_can.guard import check, check_feedback, check_link, ready
from rcp_can.joint_types import joint_types
from rcp_can.motor import abandon, drive_to, released
from rcp_can.path import Leg, Path
from rcp_can.standstill import rested
from rcp_can.together import together
from rcp_kernel.errors import AdapterUnavailable, ConfigError, InvalidValue, ModeForbids, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, check_fence, fenced_off

__all__ = ["JointGroupPart"]

_POLL_PERIOD = 0.01  # s
_FEEDBACK = 0.1  # s between two reports of a move
_MOVE = 120.0  # s, the longest that a move may take


class JointGroupPart(Part):
    """One joint group; its joints also remain separate motors.

    :raises ConfigError: one of the motors has no position control.
    """

    def __init__(
        self, name: str, config: JointGroupConfig, axes: Sequence[Axis], host: Host
    ) -> None:
        for axis in axes:
            if "position" not in axis.drive.modes:
                raise ConfigError(
                    f"joint_groups.{name}.joints: '{axis.name}' ({axis.config.profile}) has no "
                    "position control; remove it"
                )
        self._name, self._config, self._axes, self._host = name, config, tuple(axes), host
        self._types = joint_types(self._axes)
        self._states = f"sensor/{name}/joints"
        self._ended: list[RcpError] | None = None
        """Where the move in progress is notified that it has ended."""
        self._seen = 0
        for bus in {axis.bus for axis in axes}:
            bus.after_batch(self._batch)

    def resources(self) -> list[Resource]:
        """List joint positions and moves."""
        name, types = self._name, self._types
        middle = {axis.name: _near_rest(axis) for axis in self._axes}
        meta = {"joints": [axis.name for axis in self._axes]}
        return [
            Resource(
                name=self._states,
                description=f"Positions and velocities of all joints of '{name}'.",
                value=types.states,
                live=True,
                deadline=max(axis.config.timeout for axis in self._axes),
                meta=meta,
            ),
            Resource(
                name=f"actuator/{name}/joints",
                description="Target positions; a joint that is not listed keeps its position.",
                value=types.targets,
                examples=(middle, {}),
                max_age=1.0,
                valid_for=self._config.valid_for,
                safe={},
                meta=meta,
            ),
            Resource(
                name=f"action/{name}/move_joints",
                description="Move the joints together along a straight line in joint space; completes when every drive reports that it is done.",
                input=types.move,
                output=types.moved,
                feedback=types.feedback,
                examples=({"positions": middle}, {"positions": middle, "speed": 0.5}),
                timeout=_MOVE,
                max_age=1.0,
                meta=meta,
            ),
        ]

    def _batch(self) -> None:
        seen = sum(axis.status.moved for axis in self._axes)
        fresh = all(axis.online and axis.blind is None for axis in self._axes)
        if seen != self._seen and fresh:
            self._seen = seen
            if (value := self._value()) is not None:
                self._host.publish(self._states, value)

    def _value(self) -> Any:
        positions, velocities = self._positions(), [axis.velocity for axis in self._axes]
        if positions is None or None in velocities:
            return None
        kind = self._types.states
        speeds = _type_of(kind, "velocities")
        return kind(positions=positions, velocities=_filled(speeds, velocities))

    def _positions(self) -> Any:
        found = [axis.position for axis in self._axes]
        kind = _type_of(self._types.states, "positions")
        return None if None in found else _filled(kind, found)

    async def read(self, name: str) -> Any:
        """Return the last positions, if all drives are still connected."""
        if name != self._states:
            return await super().read(name)
        for axis in self._axes:
            check_link(axis)
            check_feedback(axis)
        if (value := self._value()) is None:
            raise AdapterUnavailable(
                f"not every joint of '{self._name}' has reported its position yet"
            )
        return value

    async def write(self, name: str, value: Any) -> None:
        """Set the positions of all listed joints or of none; the others keep theirs."""
        check_fence()
        targets = self._targets(value)
        if not targets and self._ended is not None:
            self._ended.append(ModeForbids("a stop of the joints ended the move"))
            return
        for axis in targets:
            self._check(axis)
        for axis in self._axes:
            if axis in targets:
                axis.command("position", targets[axis])
            else:
                self._rest(axis, ModeForbids(f"a stop of '{self._name}' ended the move"))
        if not targets:  # a stop that may not have reached every joint is no stop
            for axis in self._axes:
                check_link(axis)

    def _targets(self, value: Any) -> dict[Axis, float]:
        found = zip(self._axes, value.__struct_fields__, strict=True)
        wanted = {axis: getattr(value, field) for axis, field in found}
        return {axis: position for axis, position in wanted.items() if position is not None}

    def _rest(self, axis: Axis, reason: RcpError) -> None:
        driven = axis.owner is not None
        if driven:
            axis.forget(reason)
        if axis.status.enabled and not axis.stopped:
            if driven:  # perhaps by the drive's own trajectory, which no set-point stops
                axis.rest()
            else:
                axis.hold()

    def _check(self, axis: Axis) -> None:
        if axis.owner is not None:
            raise ModeForbids(
                f"motor '{axis.name}' is driven by {axis.owner}",
                remedy="Cancel that command first.",
            )
        check(axis)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Move the joints together."""
        for axis in self._axes:
            await ready(axis)
            await released(axis)
        return await self._move(value, name, progress)

    # What the services of its motors do with it

    @property
    def axes(self) -> Sequence[Axis]:
        """Its motors."""
        return self._axes

    def settle(self, reason: RcpError) -> None:
        """Bring all joints to rest; what drives them ends with `reason`."""
        for axis in self._axes:
            self._rest(axis, reason)
        for axis in self._axes:
            check_link(axis)

    def reset(self) -> None:
        """Do nothing: it counts nothing, and has no parameters."""

    # Moves

    async def _move(self, move: Any, name: str, progress: Progress) -> Any:
        targets = self._targets(move.positions)
        if not targets:
            raise InvalidValue("no joint to move", details={"pointer": "/positions"})
        for axis in targets:
            self._check(axis)
        legs = {axis: self._leg(axis, goal, move.speed) for axis, goal in targets.items()}
        path = Path(legs.values())
        self._ended = ended = []
        started = time.monotonic()
        for axis in legs:
            axis.owner = name
        try:
            await self._go(legs, path, ended, progress)
            await self._arrive(legs, ended)
        except (asyncio.CancelledError, RcpError) as error:
            self._ended = None
            await _halted(legs, path, error)
            raise
        finally:
            self._ended = None
            for axis in legs:
                axis.owner = axis.ended = None
        duration = time.monotonic() - started
        return self._types.moved(positions=self._positions(), duration=duration)

    def _leg(self, axis: Axis, goal: float, speed: float) -> Leg:
        acceleration = axis.config.acceleration or self._config.acceleration
        start = axis.position
        assert start is not None  # checked before the move began
        return Leg(start, goal, axis.velocity_limit * speed, acceleration)

    async def _go(
        self, legs: dict[Axis, Leg], path: Path, ended: list[RcpError], progress: Progress
    ) -> None:
        for axis, leg in legs.items():
            axis.ended = ended.append
            axis.command("position", leg.goal, path.follow(leg))
        reported_at = 0.0
        while not path.over:
            if (
                time.monotonic() - reported_at >= _FEEDBACK
                and (here := self._positions()) is not None
            ):
                reported_at = time.monotonic()
                left = max(abs(leg.goal - (axis.position or 0.0)) for axis, leg in legs.items())
                feedback = self._types.feedback(positions=here, left=left)
                progress(feedback, fraction=path.advance()[0])
            await asyncio.sleep(_POLL_PERIOD)
            if ended:
                raise ended[0]

    async def _arrive(self, legs: dict[Axis, Leg], ended: list[RcpError]) -> None:
        """Wait until every drive reports that it has reached its goal."""
        waits = together(
            drive_to(axis, m.Move(position=leg.goal), _silently) for axis, leg in legs.items()
        )
        arriving = asyncio.ensure_future(waits)
        try:
            while not arriving.done():
                await asyncio.wait((arriving,), timeout=_POLL_PERIOD)
                if ended:
                    raise ended[0]
            arriving.result()
        finally:
            arriving.cancel()
            with anyio.CancelScope(shield=True):
                await asyncio.wait((arriving,))


async def _halted(legs: dict[Axis, Leg], path: Path, why: BaseException) -> None:
    """Brake along the shared line, and wait until each joint is at rest.

    :raises RcpError: the move was cancelled, and a joint is not confirmed to be at rest.
    """
    if fenced_off():  # the stop controls the joints now: this move sends nothing more
        for axis in legs:
            axis.ended = None
        return
    settled: list[BaseException | None] = []
    with anyio.CancelScope(shield=True):
        path.brake()
        for axis in legs:
            axis.ended, axis.leaving = None, True
        while not path.over and any(axis.mode == "position" for axis in legs):  # noqa: ASYNC110
            await asyncio.sleep(_POLL_PERIOD)
        settled = await asyncio.gather(
            *(_settle(axis, why) for axis in legs), return_exceptions=True
        )
    if isinstance(why, asyncio.CancelledError):
        for error in settled:
            if isinstance(error, BaseException):
                raise error


async def _settle(axis: Axis, why: BaseException) -> None:
    try:
        if axis.mode == "position" and why is not axis.gone:
            await rested(axis)  # and it holds the position where it came to rest
        else:
            await abandon(axis, why)
    except RcpError:
        if axis.status.energised is not False:
            axis.stop()
        raise
    finally:
        axis.leaving = False


def _silently(*_: Any, **__: Any) -> None:
    """Ignore progress: the group reports it."""


def _near_rest(axis: Axis) -> float:
    low, high = max(axis.low, -1.0), min(axis.high, 1.0)
    return round(low + 0.55 * (high - low), 4)


def _type_of(struct: Any, field: str) -> Any:
    return struct.__annotations__[field]


def _filled(kind: Any, values: Sequence[Any]) -> Any:
    return kind(**dict(zip(kind.__struct_fields__, values, strict=True)))
