"""The simulated robot on the event loop's side: jobs for its thread, and their results."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, EstopActive
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, Publication, check_fence
from rcp_mujoco.camera import CameraThread, Frame
from rcp_mujoco.messages import SimulationState
from rcp_mujoco.publisher import Publisher
from rcp_mujoco.robot import Robot
from rcp_mujoco.stepper import Budget, Job, Pace, Stepper
from rcp_mujoco.waiting import Waiting
from rcp_profiles.messages import Image
from rcp_protocol.timeouts import timeout

__all__ = ["Device"]

_Result = TypeVar("_Result")
_ANSWER = 2.0  # s for the stepping thread to respond
_OVER = "the simulation has ended"
_LOOK = 0.1  # s between checks of the stepping thread


class Device:
    """One robot in a running simulation."""

    def __init__(self, robot: Robot, host: Host, safe: Mapping[str, Any]) -> None:
        """Run a robot; `safe` has the values of actuators whose commands have expired."""
        config = robot.config
        self._safe = safe
        self.robot = robot
        self.waiting = Waiting()
        self.stops = 0
        """Incremented by every stop: motion jobs submitted before it are not run."""
        self.snapshot = robot.snapshot()
        self.stalled: str | None = None
        self._host = host
        self._loop = asyncio.get_running_loop()
        self._stalled_after = config.stalled_after
        self.publisher = Publisher(robot, host, self.state)
        self.stepper = Stepper(
            robot.simulation,
            Pace(config.real_time_factor, config.paused),
            rate=config.rate,
            on_tick=self._tick,
            on_idle=self._idle,
        )
        self._blind: str | None = None
        self._reported: tuple[str | None, bool] = (None, False)
        self._cameras: CameraThread | None = None
        self._ended = False

    def start(self) -> None:
        """Start to step."""
        self.publisher.tick()
        self.stepper.start()

    def start_cameras(self, resources: list[Resource]) -> None:
        """Start the camera thread; the cameras are declared once rendering works."""
        config = self.robot.config

        def ready() -> None:
            self._host.call_soon(self._host.declare, *resources)
            self._host.call_soon(partial(self._host.discovering, active=False))

        def absent(reason: str) -> None:
            self._host.call_soon(self._go_without_cameras, reason)

        self._host.discovering(active=True)
        self._cameras = CameraThread(
            self.robot.simulation.model,
            (config.camera_width, config.camera_height),
            ready=ready,
            absent=absent,
        )
        self._cameras.start()

    def _go_without_cameras(self, reason: str) -> None:
        self._blind = reason
        self._host.discovering(active=False)
        self._report()

    async def close(self) -> None:
        """End the threads; what is asked for from now on is refused at once."""
        self._ended = True
        await asyncio.to_thread(self.stepper.close)
        if self._cameras is not None:
            await asyncio.to_thread(self._cameras.close)
        self.waiting.close(_OVER)

    async def watch_thread(self) -> None:
        """Report a stalled stepping thread, until cancelled.

        Counts its own checks, not seconds: a process that was suspended as a whole has not
        stalled.
        """
        beats, silent = self.stepper.beats, 0
        while True:
            await asyncio.sleep(_LOOK)
            silent = silent + 1 if self.stepper.beats == beats else 0
            beats = self.stepper.beats
            was = self.stalled
            self.stalled = None
            if silent * _LOOK >= self._stalled_after:
                self.stalled = f"the stepping thread has stood still for {silent * _LOOK:.1f} s"
            if (was is None) != (self.stalled is None) or self._troubles() != self._reported:
                self._report()

    # From the stepping thread

    def _tick(self) -> None:
        self.snapshot = self.robot.snapshot()
        self.publisher.tick()
        self._host.call_soon(self._ticked)

    def _idle(self) -> None:
        self.snapshot = self.robot.snapshot()
        self.publisher.idle()
        self._host.call_soon(self._ticked)

    def state(self) -> SimulationState:
        """Return how the simulation runs."""
        stepper = self.stepper
        return self.robot.state(paused=stepper.pace.paused, measured=round(stepper.measured, 3))

    # On the event loop

    def _ticked(self) -> None:
        lapsed = self.robot.simulation.lapsed
        while lapsed:
            try:
                name = lapsed.pop(0)
            except IndexError:  # the stepping thread took it back: there is a newer command
                break
            self._host.publish(f"actuator/{name}", self._safe[name], self.publisher.stamp)
        self.waiting.poll()
        if self._troubles() != self._reported and self.stalled is None:
            self._report()

    def _troubles(self) -> tuple[str | None, bool]:
        if self.stalled is not None:
            return "the stepping thread stands still", True
        snapshot = self.snapshot
        problems = [snapshot.fault, snapshot.doubt, self._blind]
        if snapshot.fault is not None:
            problems[0] = f"the simulation has stopped: {snapshot.fault}; execute service/reset"
        return "; ".join(text for text in problems if text is not None) or None, False

    def _report(self) -> None:
        trouble = self._troubles()
        was, self._reported = self._reported, trouble
        if was[1] and not trouble[1]:
            self._host.link_restored()
        if trouble != was:
            self._host.report(self.stalled or trouble[0], down=trouble[1])

    @property
    def is_latched(self) -> bool:
        """Whether an e-stop holds the robot."""
        return self._host.is_latched()

    async def do(self, run: Callable[[Robot], _Result], *, moves: bool = False) -> _Result:
        """Run a function between two steps, and return its result.

        :raises EstopActive: it moves the robot, which was stopped before the function ran.
        :raises AdapterUnavailable: the simulation has ended.
        :raises DeviceTimeout: the stepping thread does not respond.
        """
        if self._ended:
            raise AdapterUnavailable(_OVER)
        if moves:
            check_fence()
        stops, robot = self.stops, self.robot
        future: asyncio.Future[_Result] = self._loop.create_future()

        def act(_: Any) -> _Result:
            if moves and stops != self.stops:
                raise EstopActive("the robot was stopped before it could begin")
            return run(robot)

        def settle(result: Any, error: BaseException | None) -> None:
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)

        def done(result: Any, error: BaseException | None) -> None:
            self._host.call_soon(settle, result, error)

        self.stepper.submit(Job(act, done, lambda: not future.done()))
        try:
            async with timeout(_ANSWER):
                return await future
        except TimeoutError:
            text = f"the stepping thread has not answered for {_ANSWER:g} s"
            raise DeviceTimeout(self.stalled or text) from None

    def post(self, run: Callable[[Robot], object]) -> None:
        """Run a function between two steps, without waiting for it."""
        robot = self.robot
        self.stepper.submit(Job(lambda _: run(robot), lambda _, __: None, lambda: True))

    def publish(self, values: Mapping[str, Any]) -> None:
        """Publish settings."""
        for name, value in values.items():
            self._host.publish(name, value, self.publisher.stamp)

    async def step(self, steps: int, prepare: Callable[[Robot], None], progress: Progress) -> None:
        """Do steps as fast as possible; a cancellation ends them."""
        over = asyncio.Event()
        budget = Budget(steps, lambda: self._host.call_soon(over.set))

        def begin(robot: Robot) -> None:
            prepare(robot)
            self.stepper.demand(budget)

        try:
            await self.do(begin, moves=True)
            progress(fraction=0.0)
            await over.wait()
        finally:
            budget.left = 0

    # Cameras

    async def picture(self, camera: str) -> Image:
        """Render the image of a camera.

        :raises DeviceTimeout: no image was rendered in time.
        """
        future: asyncio.Future[Image] = self._loop.create_future()

        def settle(image: Image) -> None:
            if not future.done():
                future.set_result(image)

        def done(image: Image) -> None:
            self._host.call_soon(settle, image)

        await self.do(lambda robot: self._ask(robot, camera, done))
        try:
            async with timeout(_ANSWER):
                return await future
        except TimeoutError:
            raise DeviceTimeout("no picture was drawn in time") from None

    def _ask(self, robot: Robot, camera: str, done: Callable[[Image], None]) -> None:
        assert self._cameras is not None
        data = robot.simulation.data
        mocap = (data.mocap_pos.copy(), data.mocap_quat.copy())
        frame = Frame(camera, data.qpos.copy(), mocap, self.publisher.stamp, done)
        self._cameras.draw(frame)

    async def film(self, name: str, camera: str, rate: float) -> None:
        """Publish images until cancelled."""
        while True:
            began = self._loop.time()
            try:
                image = await self.picture(camera)
            except DeviceTimeout:
                continue
            stamp = self.publisher.stamp
            self._host.publish_batch([Publication(name, image, stamp)])
            await asyncio.sleep(max(0.0, began + 1 / rate - self._loop.time()))
