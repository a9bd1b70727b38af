"""The backend of the simulated rover: reads, writes, executes and stops it."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Any

import anyio

from rcp_kernel.clock import now
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    UnsupportedOperation,
)
from rcp_kernel.spi import (
    BaseBackend,
    Host,
    MotionState,
    Progress,
    RobotFacts,
    Watchdog,
    check_fence,
    is_commanded,
)
from rcp_kernel.types import Point
from rcp_sim import messages as m
from rcp_sim.config import SimConfig
from rcp_sim.device import Device
from rcp_sim.faults import unknown_target
from rcp_sim.resources import resources
from rcp_sim.sensors import pose
from rcp_sim.simulation import DEFAULT_LIMIT, Trip

__all__ = ["SimBackend", "open_sim"]

_FEEDBACK = 0.2  # s between two progress reports of a trip
_FRAME = "map"
_TOLERANCE = 0.1  # m, unless the goal has its own
_REST = 4.0  # s for a cancelled trip to come to rest


@asynccontextmanager
async def open_sim(config: SimConfig, host: Host) -> AsyncGenerator[SimBackend]:
    """Power a simulated rover on while entered.

    :raises ConfigError: the rover would start inside an obstacle, or a fault has no such target.
    :raises RuntimeError: the rover broke down.
    """
    device = Device(config, host)
    host.declare(*resources(config))
    host.describe(RobotFacts(kind="rover", model="simulated rover", frames=(_FRAME,)))
    device.boot()
    try:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(device.run)
            yield SimBackend(device)
            tasks.cancel_scope.cancel()
    except ExceptionGroup as group:
        first, *more = group.exceptions
        if more:
            raise
        raise first from None


class SimBackend(BaseBackend):
    """One simulated rover."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._sim = device.sim
        self._verbs: dict[str, Callable[[Any, Progress], Awaitable[Any]]] = {
            "action/move_to": self._move_to,
            "action/dock": self._dock,
            "service/reset_system": self._reset,
            "service/place_obstacle": self._place,
            "service/remove_obstacle": self._remove,
        }

    async def read(self, name: str) -> Any:
        """Return a fresh value."""
        await self.device.reach(name)
        if self.device.faults.stopped(name):
            raise DeviceTimeout(f"{name} has stopped publishing")
        value = self.device.publisher.make(name, now())
        return await super().read(name) if value is None else value

    async def write(self, name: str, value: Any) -> Any:
        """Apply a velocity or the speed limit; return the value in effect."""
        if name == "actuator/cmd_vel":
            v, w = value.linear.x, value.angular.z
            stop = v == 0.0 and w == 0.0
            await self.device.reach(name, stop=stop)
            if not stop:
                check_fence()
                self.device.need_feedback()
            if stop and not is_commanded():
                self._sim.end_velocity()  # the dead-man
            else:
                self._sim.drive(v, w)
        elif name == "param/speed_limit":
            await self.device.reach(name)
            self._sim.set_limit(value)
        else:
            return await super().write(name, value)
        return self.device.publisher.taken(name)

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Apply the speed limit and a velocity in one tick."""
        twist, limit = values["actuator/cmd_vel"], values["param/speed_limit"]
        stop = twist.linear.x == 0.0 and twist.angular.z == 0.0
        for name in values:
            await self.device.reach(name, stop=stop and name == "actuator/cmd_vel")
        if not stop:
            check_fence()
            self.device.need_feedback()
        self._sim.drive_within(limit, twist.linear.x, twist.angular.z)
        return {name: self.device.publisher.taken(name) for name in values}

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service; those that inject and clear faults need no link."""
        if name == "service/inject_fault":
            return self._inject(value)
        if name == "service/clear_faults":
            self.device.clear_faults(None if value is None else value.fault)
            return m.FaultsActive(self.device.faults.active)
        verb = self._verbs.get(name)
        if verb is None:
            raise UnsupportedOperation(f"'{name}' cannot be executed")
        await self.device.reach(name)
        if name.startswith("action/"):
            check_fence()
            self.device.need_feedback()
        return await verb(value, progress)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a goal that the rover cannot reach from where it is, and what a fault prevents."""
        if name == "action/move_to":
            self._check_frame(value)
            self.device.need_feedback()
            self._sim.check_goal(value.position.x, value.position.y)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Run a sensor that is only simulated while watched; the others always run."""
        return self._watch(name, rate)

    @asynccontextmanager
    async def _watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        with self.device.publisher.watched(name, rate):
            yield

    def watchdogs(self) -> Sequence[Watchdog]:
        """Report the watchdog: the rover runs in the gateway's process and stops with it."""
        return [Watchdog("the simulation runs inside the gateway's process", 0.0, verified=True)]

    async def halt(self) -> None:
        """Brake hard, end the running trip, and return once at rest."""
        await self.device.reach("halt", stop=True)
        self._sim.stop("the rover was halted", hard=True)
        await self.device.waiting.until(lambda: self._sim.rover.at_rest)

    def motion(self, robot: str | None) -> MotionState:
        """Report the motion measured by the odometry."""
        if self.device.faults.link_lost:
            return MotionState(None, "the link to the rover is lost")
        if self.device.blind:
            return MotionState(None, "the rover sends no odometry")
        rover = self._sim.rover
        if rover.at_rest and self._sim.trip is None:
            return MotionState(at_rest=True)
        return MotionState(False, f"it moves at {rover.v:.2f} m/s and turns at {rover.w:.2f} rad/s")

    def hold_stop(self, robot: str | None) -> None:
        """Brake again if the rover moves or has a velocity command."""
        faults, sim = self.device.faults, self._sim
        idle = sim.rover.at_rest and sim.trip is None and sim.velocity == (0.0, 0.0)
        if idle or not self.device.receives_stops or faults.lose_stop():
            return
        sim.stop("an e-stop is latched", hard=True)

    async def hold(self, robot: str | None) -> None:
        """Brake as for any stop, end the running trip, and return once at rest."""
        await self.device.reach("hold", stop=True)
        self._sim.stop("the rover was commanded to hold")
        await self.device.waiting.until(lambda: self._sim.rover.at_rest)

    # Actions

    async def _move_to(self, goal: m.MoveTo, progress: Progress) -> m.MoveResult:
        self._check_frame(goal)
        yaw = goal.yaw
        if goal.orientation is not None:
            yaw = _yaw(goal.orientation.z, goal.orientation.w)
        x, y = goal.position.x, goal.position.y
        tolerance = goal.tolerance or _TOLERANCE
        trip = self._sim.go(x, y, yaw=yaw, tolerance=tolerance, speed=goal.speed)
        await self._ride(trip, progress)
        rover = self._sim.rover
        return m.MoveResult(
            pose(rover, now()),
            rover.travelled - trip.odometer,
            trip.seconds,
            math.dist((rover.x, rover.y), (x, y)),
        )

    @staticmethod
    def _check_frame(goal: m.MoveTo) -> None:
        if goal.frame != _FRAME:
            raise InvalidValue(
                f"the rover has no frame '{goal.frame}' for its goals",
                details={"pointer": "/frame"},
                remedy=f"Give the goal in the frame '{_FRAME}'.",
            )
        if goal.orientation is not None and goal.yaw is not None:
            raise InvalidValue("give 'orientation' or 'yaw', not both")

    async def _dock(self, _: m.Dock | None, progress: Progress) -> m.DockResult:
        await self._ride(self._sim.dock(), progress)
        self._sim.plug_in()
        return m.DockResult(pose(self._sim.rover, now()), self._sim.pack.charge, charging=True)

    async def _ride(self, trip: Trip, progress: Progress) -> None:
        """Follow a trip to its end; a cancellation brakes the rover first."""
        device = self.device
        device.report_task(trip, "started", f"Driving to a goal {trip.length:.1f} m away.")
        try:
            while not trip.done:
                self._report_progress(trip, progress)
                due = device.uptime + _FEEDBACK
                await device.waiting.until(lambda due=due: trip.done or device.uptime >= due)
        except anyio.get_cancelled_exc_class():
            await self._abandon(trip)
            raise
        if trip.failure is not None:
            device.report_task(trip, "failed", f"Failed: {trip.failure}.")
            if device.blind:
                raise DeviceTimeout(
                    "the rover sends no odometry; it was stopped", remedy="See event/fault."
                )
            if device.faults.link_lost:
                raise AdapterUnavailable("the link to the rover was lost; it stopped by itself")
            raise DeviceRejected(trip.failure)
        self._report_progress(trip, progress)
        device.report_task(trip, "completed", f"Arrived after {trip.seconds:.1f} s.")

    async def _abandon(self, trip: Trip) -> None:
        if self._sim.trip is trip:
            self._sim.stop("cancelled")
        with anyio.move_on_after(_REST, shield=True), suppress(AdapterUnavailable):
            await self.device.waiting.until(lambda: self._sim.rover.at_rest)
        self.device.report_task(trip, "cancelled", "Cancelled; the rover has stopped.")

    def _report_progress(self, trip: Trip, progress: Progress) -> None:
        rover = self._sim.rover
        left = trip.follower.remaining(rover)
        pace = min(self._sim.limit, trip.follower.speed)
        feedback = m.MoveFeedback(
            left, left / pace if pace else None, trip.follower.phase, Point(rover.x, rover.y)
        )
        done = 1.0 if trip.done else max(0.0, 1 - left / trip.length) if trip.length else 0.0
        progress(feedback, fraction=done)

    # Services

    async def _reset(self, what: m.ResetSystem | None, _: Progress) -> m.ResetResult:
        what = what or m.ResetSystem()
        sim, device = self._sim, self.device
        removed = sim.remove_all() if what.obstacles else 0
        sim.reset_body(pose=what.pose, battery=what.battery)
        cleared = device.clear_faults() if what.faults else 0
        if what.speed_limit:
            sim.set_limit(DEFAULT_LIMIT)
        await device.waiting.until(lambda: sim.rover.at_rest)
        if what.odometry:
            device.publisher.sensors.wheels.zero()
        device.boot("reset")
        return m.ResetResult(cleared, removed, pose(sim.rover, now()))

    async def _place(self, box: m.Box, _: Progress) -> m.ObstacleId:
        return m.ObstacleId(self._sim.place(box))

    async def _remove(self, box: m.ObstacleId, _: Progress) -> m.Obstacles:
        self._sim.remove(box.id)
        return m.Obstacles(dict(self._sim.floor.placed))

    def _inject(self, spec: m.FaultSpec) -> m.FaultsActive:
        if wrong := unknown_target(spec):
            raise InvalidValue(wrong, details={"pointer": "/target"})
        self.device.strike(spec)
        active = self.device.faults.active
        return m.FaultsActive([*active, spec] if spec.fault == "link_lost" else active)


def _yaw(z: float, w: float) -> float:
    return 2 * math.atan2(z, w)
