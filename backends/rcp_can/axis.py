"""One motor under control: what is asked of it, ramped and watched, whatever its make.

Nothing here moves a drive that nobody asked to move: a set-point is forgotten when the drive resets,
falls out of its enabled state, or is not heard of, and only a new command makes another.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import structlog

from rcp_can import motor_messages as m
from rcp_can import views
from rcp_can.bus import Bus
from rcp_can.codec import clamp
from rcp_can.config_motor import MotorConfig
from rcp_can.drive import Drive, Fault
from rcp_can.faultbook import FaultBook
from rcp_can.guard import STALLED, Loss, check_bus, heartless, loss
from rcp_can.health import Health
from rcp_can.messages import Condition
from rcp_can.ramp import Ramp
from rcp_can.setpoint import set_point
from rcp_kernel.errors import AdapterUnavailable, ModeForbids, QueueFull, RcpError
from rcp_kernel.spi import Host

if TYPE_CHECKING:
    import can

__all__ = ["Axis"]

log = structlog.get_logger("rcp.can")
_RESTING = 0.02  # rad/s at the drive's shaft, below which it rests, whatever the motor's tolerance
_LAG = 0.2  # s that a joint may be behind its ramp, and still stop where that stops
_RETRY = 1.0  # s between two attempts to configure a drive


class Axis:
    """A motor: its drive, its limits, and the set-point that stands."""

    def __init__(
        self, name: str, config: MotorConfig, drive: Drive, bus: Bus, host: Host, health: Health
    ) -> None:
        self.name, self.config, self.drive, self.bus = name, config, drive, bus
        self.status = drive.status
        reach, gear = drive.reach(), config.gear
        self.ratio = gear * config.direction
        self.velocity_limit = min(config.velocity, reach.velocity / gear)
        self.torque_limit = min(config.torque, reach.torque * gear)
        low, high = config.position or (-reach.position / gear, reach.position / gear)
        span = reach.position / gear
        self.low, self.high = max(low, -span), min(high, span)
        self.ramp = Ramp(self.velocity_limit, config.acceleration)
        self.mode: m.Mode | None = None
        self.goal = 0.0
        self.online = False
        self.stopping = False
        self.owner: str | None = None
        """The action that drives it now."""
        self.gone: RcpError | None = None
        """Why the last set-point was dropped."""
        self.leaving = False
        """Whether an action that is over still brings it to rest."""
        self.ended: Callable[[RcpError], None] | None = None
        """Told when what the action commanded is forgotten."""
        self._host, self._health = host, health
        self.heard = 0.0
        """When it said something, by the monotonic clock."""
        self._after_stop = 0
        self._seen = (0, 0, 0, 0)
        self._shown: m.MotorState | None = None
        self.faults = FaultBook(name, host)
        self.configured = False
        """Whether the drive is set up since it was last heard to boot or to come back."""
        self.configuring: asyncio.Task[None] | None = None
        self._tick = 0
        self._step_due = False
        self._wanted_on = self._in_use = False
        self.first = asyncio.Event()
        """Set when the drive was heard for the first time, and is configured."""
        bus.listen(self._take, *drive.routes())
        bus.after_batch(self._batch)
        bus.on_state.append(self._bus_turned)

    # What the drive says

    @property
    def position(self) -> float | None:
        """Where the joint is, rad."""
        raw = self.status.position
        return None if raw is None else raw / self.ratio + self.config.offset

    @property
    def velocity(self) -> float | None:
        """How fast it turns, rad/s."""
        raw = self.status.velocity
        return None if raw is None else raw / self.ratio

    @property
    def state(self) -> m.State:
        """How it stands, in one word."""
        if not self.online:
            return "offline"
        if self.status.faults and not self.status.enabled:
            return "fault"
        if self.stopping:
            return "stopping"
        return "enabled" if self.status.enabled else "disabled"

    @property
    def met(self) -> bool:
        """Whether it was ever heard."""
        return self.heard > 0.0

    @property
    def resting(self) -> bool:
        """Whether it is known to stand, or to have no power."""
        velocity = self.status.velocity
        slow = velocity is not None and abs(velocity) <= max(
            _RESTING, self.config.standstill * self.config.gear
        )
        return slow or (velocity is None and self.status.enabled is False)

    def _take(self, message: can.Message) -> None:
        if self.drive.take(message):
            self.heard = time.monotonic()

    def _batch(self) -> None:
        status = self.status
        seen = status.moved, status.told, status.resets, status.twins
        if seen == self._seen:
            return
        old, self._seen = self._seen, seen
        if not self.online:
            if heartless(self, time.monotonic()):
                return
            self._appear()
        if status.resets != old[2]:
            self._reset()
        if status.twins != old[3]:
            self._doubled()
        if self._wanted_on and not status.enabled and status.enabled is not None:
            self._dropped()
        self.drive.look()
        if status.moved != old[0]:
            self._host.publish(f"sensor/{self.name}/motion", views.motion(self))
            if self.configured and status.position is not None:
                self.first.set()
        self.show()

    def _appear(self) -> None:
        self.online = True
        self.faults.take_back("feedback_lost", "heartbeat_lost")
        self._health.say(self.name, None)
        self._configure()

    def _configure(self) -> None:
        if self.configuring is None or self.configuring.done():
            self.configured = False
            self.configuring = asyncio.create_task(self._prepare(), name=f"can {self.name}")

    async def _prepare(self) -> None:
        while self.online:
            try:
                await self.drive.configure()
            except RcpError as error:
                self.fault("configuration", f"it could not be configured: {error.message}")
                await asyncio.sleep(_RETRY)
            else:
                self.faults.take_back("configuration")
                self.configured = True
                if self.status.position is not None:
                    self.first.set()
                self.show()
                return

    def _reset(self) -> None:
        if self._wanted_on or self.mode is not None:
            self.fault("reset", "the drive has started anew while it was in use", lasting=False)
        self._wanted_on = False
        self.forget(AdapterUnavailable(f"motor '{self.name}': the drive has started anew"))
        self._configure()

    def _doubled(self) -> None:
        text = f"two drives answer to node {self.drive.node}"
        self.fault("duplicate_node", text)
        if self._in_use:
            self.forget(ModeForbids(f"motor '{self.name}': {text}"))
            self.stop()

    def _dropped(self) -> None:
        self._wanted_on = False
        why = "; ".join(f.text for f in self.status.faults) or "it switched itself off"
        if not self.status.faults and not self.stopping:
            self.fault("switched_off", "the drive has switched itself off", lasting=False)
        self.forget(ModeForbids(f"motor '{self.name}' is not enabled any more: {why}"))

    # What is asked of it

    def command(
        self, mode: m.Mode, value: float, path: Callable[[], tuple[float, float]] | None = None
    ) -> None:
        """Make a set-point stand, until the next; a path tells how it is reached."""
        self.stopping = False
        if mode != self.mode:
            self.ramp.start(self.position or 0.0, self.velocity or 0.0)
        self.ramp.limit, self.ramp.path = self.velocity_limit, path
        self.mode, self.goal = mode, value
        if self._step_due:
            self._step_due = False
            self.step(1 / self.config.rate)
        self.show()

    def rest(self) -> None:
        """Come to rest by the ramp, and stay there."""
        if self.status.enabled:
            self.command("velocity" if "velocity" in self.drive.modes else "torque", 0.0)
        else:
            self.forget(None)

    def hold(self) -> None:
        """Come to rest by the ramp, and keep to the position where that is."""
        if self.mode == "position" and self.position is not None:
            here, ramp = self.position, self.ramp
            near = abs(ramp.velocity) * _LAG + self.config.tolerance
            goal = clamp(ramp.position, here - near, here + near) + ramp.braking
            self.command("position", clamp(goal, self.low, self.high))
        elif self.mode is not None:
            self.rest()

    def stop(self) -> None:
        """Quick stop: brake hard, again and again until the drive says that it rests."""
        self.mode = None
        self.stopping = True
        self._after_stop = self.status.moved
        self._send(self.drive.stop)
        self.show()

    def forget(self, reason: RcpError | None) -> None:
        """Drop the set-point that stands; an action that made it is told why."""
        self.mode, self.gone = None, reason
        ended, self.ended = self.ended, None
        if ended is not None and reason is not None:
            ended(reason)
        self.show()

    async def enable(self) -> None:
        """Switch on, at rest.

        :raises RcpError: as `check_bus`, and of the drive.
        """
        check_bus(self)
        self.forget(None)
        self.stopping = False
        await self.drive.enable()
        self._wanted_on = self._in_use = True
        if self.drive.holds:
            self.rest()
        self.show()

    async def disable(self) -> None:
        """Switch off."""
        self._wanted_on = False
        self.forget(ModeForbids(f"motor '{self.name}' was disabled"))
        self.stopping = False
        await self.drive.disable()
        self._in_use = False

    # Time

    def tick(self, dt: float) -> None:
        """Send what is due; called at the motor's rate."""
        self._tick += 1
        self._step_due = True
        if self.online and (why := loss(self, time.monotonic())) is not None:
            self._lose(why)
        if not self.bus.up:
            return
        if self.mode is not None and self.bus.lag > STALLED:
            self._stall()
        if self.stopping:
            if self.resting and self.status.moved > self._after_stop + 2:
                self.stopping = False
                if self.drive.holds and self.status.enabled:
                    self.rest()
                self.show()
            else:
                self._send(self.drive.stop)
        elif self.mode is not None and self.status.enabled:
            self._step_due = False
            self.step(dt)
        self._send(lambda: self.drive.poll(self._tick))

    def step(self, dt: float) -> None:
        """Send the next set-point of the ramp."""
        due = set_point(self, dt)
        if due is not None:
            self._send(lambda: self.drive.command(*due))

    def _send(self, function: Callable[[], object]) -> None:
        try:
            function()
        except RcpError as error:  # the bus's own state tells of it; the next tick tries again
            log.debug("not_sent", motor=self.name, error=error.message)

    def _lose(self, why: Loss) -> None:
        self.online = False
        self._wanted_on = False
        was_on = bool(self.status.enabled) or self.mode is not None
        self.status.enabled = None
        self.fault(why.fault, why.text)
        self._health.say(self.name, f"motor '{self.name}': {why.text}")
        self.forget(AdapterUnavailable(f"motor '{self.name}': {why.text}"))
        if was_on:  # it may still run by its last set-point, and still hear us
            self.stop()

    def _stall(self) -> None:
        """Drop a set-point that does not leave: the ramp would be far ahead when it does."""
        text = f"its set-points have not left for {STALLED:g} s: the bus takes no frames"
        self.fault("not_sent", text, lasting=False)
        self.forget(QueueFull(f"motor '{self.name}': {text}"))
        self.stop()

    def _bus_turned(self, _was: Condition, now: Condition) -> None:
        """Forget at once what goes over a bus that is lost: nothing moves when it is back."""
        if self.online and now in ("bus_off", "down"):
            self._lose(Loss("feedback_lost", f"CAN bus '{self.bus.name}' is {now}"))

    # What is shown

    def fault(self, name: str, text: str, *, lasting: bool = True) -> None:
        """Tell of a fault that the gateway sees; a lasting one stands until it is taken back."""
        fault = Fault(name, text)
        if lasting:
            self.faults.note(fault)
            self.show()
        else:
            self.faults.tell(fault, active=True)

    async def clear_faults(self) -> None:
        """Have the drive acknowledge its faults, and take back those that the gateway has seen."""
        await self.drive.clear_faults()
        self.faults.absolve()
        self.show()

    def show_health(self) -> None:
        """Publish temperatures and supply."""
        if self.online:
            self._host.publish(f"sensor/{self.name}/health", views.health(self))

    def show(self) -> None:
        """Publish the state, and the faults that came or went, if something changed."""
        self.faults.update(self.status.faults)
        value = views.state(self)
        if value != self._shown:
            self._shown = value
            self._host.publish(f"sensor/{self.name}/state", value)

    async def close(self) -> None:
        """Let go of what runs in the background."""
        if self.configuring is not None:
            self.configuring.cancel()
            await asyncio.wait((self.configuring,))
