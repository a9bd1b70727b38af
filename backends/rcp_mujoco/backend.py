"""The backend of a simulated robot: reads, writes, executes and stops it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
    PreconditionFailed,
    UnsupportedOperation,
)
from rcp_kernel.spi import (
    BaseBackend,
    Host,
    MotionState,
    Progress,
    RobotFacts,
    Watchdog,
    is_commanded,
)
from rcp_kernel.values import value_type
from rcp_mujoco.actions import Actions
from rcp_mujoco.config import MujocoConfig
from rcp_mujoco.device import Device
from rcp_mujoco.messages import Reset, SimulationState
from rcp_mujoco.model_types import given
from rcp_mujoco.resources import Catalogue, camera_resources, catalogue
from rcp_mujoco.robot import Robot
from rcp_protocol.timeouts import timeout

__all__ = ["MujocoBackend", "open_robot"]

_HALT = 5.0  # s for the brakes to bring a robot to rest


def _kind(robot: Robot) -> str | None:
    if robot.arm is not None:
        return "arm" if robot.wheels is None else "mobile_manipulator"
    return None if robot.wheels is None else "rover"


@asynccontextmanager
async def open_robot(config: MujocoConfig, host: Host) -> AsyncGenerator[MujocoBackend]:
    """Load the model and step it while entered.

    :raises ConfigError: the model does not load, or lacks a part.
    """
    robot = await asyncio.to_thread(Robot, config)
    readings = robot.readings()
    offered = catalogue(robot, readings)
    safe = {drive.name: drive.safe for drive in robot.simulation.drives}
    if robot.wheels is not None:
        safe["cmd_vel"] = value_type(offered.type_of("actuator/cmd_vel")).convert({})
    device = Device(robot, host, safe)
    host.declare(*offered.resources)
    host.describe(RobotFacts(kind=_kind(robot)))
    cameras = camera_resources(robot) if config.cameras else {}
    backend = MujocoBackend(device, offered, {r.name: name for name, r in cameras.items()})
    device.publish(backend.settings())
    device.start()
    if cameras:
        device.start_cameras(list(cameras.values()))
    watching = asyncio.create_task(device.watch_thread(), name="watchdog of the stepping thread")
    try:
        yield backend
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await device.close()


class MujocoBackend(BaseBackend):
    """One robot in a simulation of its own."""

    def __init__(self, device: Device, offered: Catalogue, cameras: Mapping[str, str]) -> None:
        self.device = device
        self._offered = offered
        self._cameras = cameras
        self._actions = Actions(device)
        self._drives = {f"actuator/{d.name}": d for d in device.robot.simulation.drives}
        actions = self._actions
        self._verbs: dict[str, Callable[[Any, Progress], Awaitable[Any]]] = {
            "action/move_to": actions.move_to,
            "action/move_joints": actions.move_joints,
            "action/follow_trajectory": actions.follow_trajectory,
            "action/move_tool": actions.move_tool,
            "action/move_gripper": actions.move_gripper,
            "service/step": self._step,
            "service/reset": self._reset,
            "service/reset_system": self._reset_system,
        }

    # Values

    async def read(self, name: str) -> Any:
        """Measure now."""
        if name in self._cameras:
            return await self.device.picture(self._cameras[name])
        value = await self.device.do(lambda robot: self._value(robot, name))
        return await super().read(name) if value is None else value

    def _value(self, robot: Robot, name: str) -> Any:
        if name in self._drives:
            return float(robot.simulation.data.ctrl[self._drives[name].number])
        pace = self.device.stepper.pace
        match name:
            case "param/paused":
                return pace.paused
            case "param/real_time_factor":
                return pace.factor
            case "param/speed_limit" if robot.wheels is not None:
                return robot.wheels.limit
            case "actuator/cmd_vel" if robot.wheels is not None:
                return self._velocity(*robot.wheels.target)
            case _:
                return self.device.publisher.read(name)

    def _velocity(self, v: float, w: float) -> Any:
        kind = value_type(self._offered.type_of("actuator/cmd_vel"))
        return kind.convert({"linear": {"x": v}, "angular": {"z": w}})

    def settings(self) -> dict[str, Any]:
        """Return the settings by name."""
        names = [r.name for r in self._offered.resources if r.live]
        kept = [name for name in names if name.startswith(("param/", "actuator/"))]
        return {name: self._value(self.device.robot, name) for name in kept}

    async def write(self, name: str, value: Any) -> Any:
        """Set a control, a velocity, or the pace."""
        if name in self._drives:
            moves, commanded = value != self._drives[name].safe, is_commanded()
            await self.device.do(
                lambda robot: self._control(robot, name, value, commanded=commanded), moves=moves
            )
            return None
        stepper, wheels = self.device.stepper, self.device.robot.wheels
        match name:
            case "param/paused":
                await self.device.do(lambda _: stepper.set_pace(paused=value))
            case "param/real_time_factor":
                await self.device.do(lambda _: stepper.set_pace(factor=value))
            case "param/speed_limit" if wheels is not None:
                await self.device.do(lambda _: wheels.set_limit(value))
            case "actuator/cmd_vel" if wheels is not None:
                return await self._drive(value.linear.x, value.angular.z)
            case _:
                return await super().write(name, value)
        return None

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Set several controls between the same two steps."""
        moves = any(value != self._drives[name].safe for name, value in values.items())
        commanded = is_commanded()

        def control(robot: Robot) -> None:
            if moves:
                robot.simulation.need_whole()
                self._need_idle(robot)
            for name, value in values.items():
                self._control(robot, name, value, commanded=commanded)

        await self.device.do(control, moves=moves)
        return {}

    async def _drive(self, v: float, w: float) -> Any:
        valid_for = self.device.robot.config.valid_for
        commanded = is_commanded()

        def drive(robot: Robot) -> tuple[float, float]:
            assert robot.wheels is not None
            if commanded or (v, w) != (0.0, 0.0):
                robot.wheels.drive(v, w, valid_for)
            else:  # the dead-man of a velocity that a trip may have replaced
                robot.wheels.end_velocity()
            return robot.wheels.target

        return self._velocity(*await self.device.do(drive, moves=(v, w) != (0.0, 0.0)))

    def _control(self, robot: Robot, name: str, value: float, *, commanded: bool = True) -> None:
        drive = self._drives[name]
        if value == drive.safe:
            if commanded and robot.wheels is not None and robot.wheels.moves(drive):
                robot.wheels.yield_wheels()  # they would set it again at the next step
            robot.simulation.neutral(drive)
            return
        self._need_idle(robot)
        if robot.wheels is not None:
            robot.wheels.yield_wheels()
        robot.simulation.command(drive, value, robot.config.valid_for)

    def _need_idle(self, robot: Robot) -> None:
        if robot.busy is not None:
            raise ModeForbids(
                f"the robot is carrying out {robot.busy}", remedy="Cancel that command first."
            )

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Publish scans and images while they are watched; everything else is always published."""
        return self._watch(name, rate)

    @asynccontextmanager
    async def _watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        if name not in self._cameras:
            with self.device.publisher.watched(name, rate):
                yield
            return
        fastest = self.device.robot.config.camera_rate
        film = self.device.film(name, self._cameras[name], min(fastest, rate or fastest))
        task = asyncio.create_task(film, name=f"film {name}")
        try:
            yield
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    # Commands

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or a service to its end."""
        verb = self._verbs.get(name)
        if verb is None:
            raise UnsupportedOperation(f"'{name}' cannot be executed")
        return await verb(value, progress)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a goal that the robot cannot reach."""
        self._actions.foresee(name, value)

    async def _step(self, step: Any, progress: Progress) -> Any:
        controls = given(step.controls)

        def prepare(robot: Robot) -> None:
            if not self.device.stepper.pace.paused:
                raise PreconditionFailed(
                    "the simulation runs by itself", remedy="Write true to param/paused first."
                )
            robot.simulation.need_whole()
            for name, control in controls.items():
                self._control(robot, f"actuator/{name}", control)

        await self.device.step(step.steps, prepare, progress)
        self._need_whole()
        return await self.device.do(self._observe)

    def _observe(self, robot: Robot) -> Any:
        kind, publisher = self._offered.observation, self.device.publisher
        stamp = publisher.stamp
        values = [reading.read(stamp) for reading in publisher.readings]
        fields = {f"sensor_{number}": value for number, value in enumerate(values)}
        measured = kind.__annotations__["sensors"](**fields)
        return kind(time=robot.simulation.time, sensors=measured)

    def _need_whole(self) -> None:
        if (fault := self.device.robot.simulation.fault) is not None:
            raise DeviceRejected(
                f"the simulation has stopped: {fault}",
                remedy="Execute service/reset to start it again.",
            )

    async def _reset(self, what: Reset | None, _: Progress) -> SimulationState:
        seed = None if what is None else what.seed

        def reset(robot: Robot) -> SimulationState:
            robot.reset(seed)
            if self.device.is_latched:
                robot.simulation.brake("an e-stop is latched")
            return self.device.state()

        return await self._settled(reset)

    async def _reset_system(self, _: None, __: Progress) -> SimulationState:
        def reset(robot: Robot) -> None:
            robot.simulation.need_whole()
            robot.simulation.brake("the system was reset")

        await self.device.do(reset)
        await self._rest()

        def count(robot: Robot) -> SimulationState:
            for controller in robot.simulation.controllers:
                controller.reset()
            return self.device.state()

        return await self._settled(count)

    async def _settled(self, change: Callable[[Robot], SimulationState]) -> SimulationState:
        state = await self.device.do(change)
        number = self.device.snapshot.number
        await self.device.waiting.until(lambda: self.device.snapshot.number > number)
        self.device.publish(self.settings())
        return state

    # Stops

    async def halt(self) -> None:
        """Apply the brakes, and return once at rest."""
        self.device.stops += 1
        await self.device.do(lambda robot: robot.simulation.brake("the robot was halted"))
        await self._rest()

    async def _rest(self) -> None:
        """Wait until the robot is measured to be at rest.

        :raises DeviceTimeout: it does not come to rest, or the simulation is paused.
        """
        device = self.device
        number = device.snapshot.number
        try:
            async with timeout(_HALT):
                await device.waiting.until(lambda: device.snapshot.number > number)
                await device.waiting.until(
                    lambda: device.snapshot.at_rest or self._hindrance() is not None
                )
        except TimeoutError:
            raise DeviceTimeout(
                device.stalled or f"the robot still moves at {device.snapshot.speed:.2f}"
            ) from None
        if not device.snapshot.at_rest:
            raise DeviceTimeout(self._hindrance() or "the robot moves")

    def _hindrance(self) -> str | None:
        """Return why the robot cannot come to rest."""
        device = self.device
        if device.snapshot.fault is not None:
            return f"the simulation has stopped: {device.snapshot.fault}"
        if device.stepper.pace.paused and not device.snapshot.at_rest:
            return "the simulation is paused while the robot moves; write false to param/paused"
        return None

    def motion(self, robot: str | None) -> MotionState:
        """Report the motion, by the velocities of the robot's joints."""
        device = self.device
        if device.stalled is not None:
            return MotionState(None, device.stalled)
        if (hindrance := self._hindrance()) is not None:
            return MotionState(False, hindrance)
        if device.snapshot.at_rest:
            return MotionState(at_rest=True)
        return MotionState(False, f"a joint moves at {device.snapshot.speed:.2f} (m/s or rad/s)")

    def hold_stop(self, robot: str | None) -> None:
        """Apply the brakes again, if they are not applied."""
        self.device.stops += 1
        if not self.device.snapshot.braking:
            self.device.post(lambda robot: robot.simulation.brake("an e-stop is latched"))

    async def hold(self, robot: str | None) -> None:
        """Stop as by an e-stop; the next command releases the brakes."""
        await self.halt()

    def watchdogs(self) -> Sequence[Watchdog]:
        """Report the watchdog: the robot exists in the gateway's process and stops with it."""
        return [Watchdog("the simulation runs inside the gateway's process", 0.0, verified=True)]
