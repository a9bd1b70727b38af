"""Control of one motor of any make: set-points, ramps and monitoring.

No drive moves without a command: a set-point is discarded when the drive resets,
falls out of its enabled state, or its feedback is lost, and only a new command makes another.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import structlog

from rcp_can import motor_messages as m
from rcp_can import views
from rcp_can.axis_state import AxisState, Loss
from rcp_can.bus import Bus
from rcp_can.codec import clamp
from rcp_can.config_motor import MotorConfig
from rcp_can.drive import Drive, Fault
from rcp_can.facts import Facts
from rcp_can.health import Health
from rcp_can.messages import Condition
from rcp_can.preconditions import (
    STALLED,
    heartless,
    loss,
    stale,
)
from rcp_can.setpoint import set_point, torque_offset
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    ModeForbids,
    QueueFull,
    RcpError,
)
from rcp_kernel.spi import Host, check_fence, unfenced

if TYPE_CHECKING:
    import can

__all__ = ["Axis"]

log = structlog.get_logger("rcp.can")
_LAG = 0.2  # s of lag behind the ramp at which a joint can still hold the ramp's end
_RETRY = 1.0  # s between two attempts to configure a drive, or to cut its torque
_LATE = 0.1  # s between two ticks, after which received frames may still be queued
_FROZEN = 0.5  # s between two ticks, after which a watchdog or the guard may have stopped the motor
_STILL = 3  # consecutive velocity reports that prove standstill


class Axis(AxisState):
    """One motor: its drive, its limits and its current set-point."""

    def __init__(
        self,
        name: str,
        config: MotorConfig,
        drive: Drive,
        bus: Bus,
        host: Host,
        health: Health,
        facts: Facts,
    ) -> None:
        super().__init__(name, config, drive, bus, host)
        self._host, self._health, self._facts = host, health, facts
        self.released = False
        """Whether the torque has been cut after a stop."""
        self._still: deque[float] = deque(maxlen=_STILL)
        """When the last consecutive velocity reports that show standstill were received."""
        self._braked_at = float("-inf")
        self.owner: str | None = None
        """The action that currently controls the motor."""
        self.gone: RcpError | None = None
        """Why the last set-point was dropped."""
        self.leaving = False
        """Whether an action that has ended is still bringing the motor to rest."""
        self.ended: Callable[[RcpError], None] | None = None
        """Called when the set-point of the action is discarded."""
        self._releasing: asyncio.Task[None] | None = None
        self._lost_once = self._outdated = False
        self._ticked, self._velocities = time.monotonic(), 0
        self._late, self._frozen = (max(each, 1.5 / config.rate) for each in (_LATE, _FROZEN))
        self._fell = False
        """Whether the drive was seen off while it was to be on, even if it is on again by now."""
        self._seen = (0, 0, 0, 0)
        self._shown: m.MotorState | None = None
        self._tick, self._step_due = 0, False
        self.wanted_on = self.in_use = False
        """Whether the gateway enabled the motor and expects it to be enabled; whether it ever
        was."""
        self.first = asyncio.Event()
        """Set once the drive has sent its first message and is configured."""
        bus.listen(self._take, *drive.routes(), whose=self.name)
        bus.after_batch(self._batch)
        bus.on_state.append(self._bus_turned)

    # Reports from the drive

    def _take(self, message: can.Message) -> None:
        status = self.status
        status.frame_at = self.bus.received_at(message)
        try:
            if self.drive.take(message):
                self.last_message_at = time.monotonic()
                self._look()
        finally:
            status.frame_at = None

    def _look(self) -> None:
        """Note what may be over before the end of a batch, which may hold a second of frames."""
        if self.wanted_on and self.status.enabled is False:
            self._fell = True
        if self.status.counts["velocity"] != self._velocities and not self.slow:
            self._still.clear()

    def _batch(self) -> None:
        status = self.status
        seen = status.moved, status.reports, status.resets, status.twins
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
        if self.wanted_on and self._fell:
            self._dropped()
        self._fell = False
        if status.counts["velocity"] != self._velocities:
            self._velocities = status.counts["velocity"]
            if self.slow:
                self._still.append(status.received_at["velocity"])
            else:
                self._still.clear()
        self.drive.wake_waiters()
        if status.moved != old[0]:
            self._host.publish(f"sensor/{self.name}/motion", views.motion(self))
            self._meet()
        self.show()

    def _meet(self) -> None:
        """Note that the drive is there, once it has reported where the joint is, if it ever does."""
        placed = "position" not in self.signals or self.status.position is not None
        if self.configured and placed:
            self.first.set()

    def rests_since(self, moment: float) -> bool:
        """Return whether enough reports received after a monotonic time show standstill."""
        still = self._still
        return self.resting and len(still) == _STILL and still[0] > moment

    def _appear(self) -> None:
        self.online = True
        if self._lost_once or self._host.is_latched():
            self._host.link_restored()  # before anything else is sent to the drive
        self._lost_once = False
        self.faults.clear("feedback_lost", "heartbeat_lost")
        self._health.report(self.name, None)
        self._configure()

    def _configure(self) -> None:
        self._outdated = True
        if self.configuring is None or self.configuring.done():
            self.configured = False
            with unfenced():
                self.configuring = asyncio.create_task(self._prepare(), name=f"can {self.name}")

    async def _prepare(self) -> None:
        while self.online:
            self._outdated = False
            try:
                await self.drive.configure()
            except RcpError as error:
                text = f"it could not be configured: {error.message}"
                self.fault("configuration", text)
                self._health.report(self.name, f"motor '{self.name}': {text}")
                await asyncio.sleep(_RETRY)
            else:
                if self._outdated:  # it rebooted meanwhile, and has forgotten the first settings
                    continue
                if self.faults.get("configuration") is not None:
                    self.faults.clear("configuration")
                    self._health.report(self.name, None)
                self.configured, self.configured_at = True, time.monotonic()
                self._meet()
                self._report_protection()
                self._facts.report(self.name, self.drive.identity)
                self.show()
                return

    def _report_protection(self) -> None:
        found = self.drive.protection
        if found.within is None:
            log.warning("no_watchdog", motor=self.name, found=found.mechanism)
        else:
            log.info(
                "watchdog",
                motor=self.name,
                mechanism=found.mechanism,
                within=found.within,
                verified=found.verified,
            )

    def _reset(self) -> None:
        used = self.wanted_on or self.mode is not None or self.stopping
        text = self.status.reset
        if self.wanted_on or self.mode is not None:
            self.fault("reset", f"{text} while in use", lasting=False)
        self.wanted_on = False
        self.forget(AdapterUnavailable(f"motor '{self.name}': {text}"))
        if used:  # a drive that has only left its operational state may still be turning
            self.stop()
        self._configure()

    def _doubled(self) -> None:
        text = f"two drives respond to node {self.drive.node}"
        self.fault("duplicate_node", text)
        if self.in_use:
            self.forget(ModeForbids(f"motor '{self.name}': {text}"))
            self.stop()

    def _dropped(self) -> None:
        self.wanted_on = False
        why = "; ".join(f.text for f in self.status.faults) or "it switched itself off"
        if not self.status.faults and not self.stopping:
            self.fault("switched_off", "the drive has switched itself off", lasting=False)
        self.forget(ModeForbids(f"motor '{self.name}' is no longer enabled: {why}"))

    # Commands

    def command(
        self, mode: m.Mode, value: float, path: Callable[[], tuple[float, float]] | None = None
    ) -> None:
        """Set the set-point, valid until the next one; `path` defines the trajectory towards it.

        :raises EstopActive: the request was cancelled by a stop.
        """
        check_fence()
        self.stopping = False
        self.stop_began = None
        if mode != self.mode:
            self.ramp.start(self.position or 0.0, self.velocity or 0.0)
        self.ramp.limit, self.ramp.path = self.velocity_limit, path
        self.mode, self.goal = mode, value
        if self._step_due:
            self._step_due = False
            self.step(1 / self.config.rate)
        self.show()

    def await_cycle(self) -> None:
        """Send the next set-point in the next cycle, together with those of the other motors."""
        self._step_due = False

    def rest(self) -> None:
        """Decelerate along the ramp and stay at rest."""
        if self.status.enabled:
            self.command("velocity" if "velocity" in self.drive.modes else "torque", 0.0)
        else:
            self.forget(None)

    def hold(self) -> None:
        """Decelerate along the ramp and hold the final position."""
        if self.mode == "position" and self.position is not None:
            here, ramp = self.position, self.ramp
            near = abs(ramp.velocity) * _LAG + self.config.tolerance
            goal = clamp(ramp.position, here - near, here + near) + ramp.braking
            self.command("position", clamp(goal, self.low, self.high))
        elif self.mode is not None:
            self.rest()

    def pause(self, reason: RcpError) -> None:
        """Decelerate along the ramp, hold, and end the current command with `reason`."""
        own = self.drive.moves and self.owner is not None
        if self.stopped and self.resting:
            pass  # a stop already holds the joint, and its torque may be about to be cut
        elif self.status.enabled and not self.stopping:
            if own or (self.mode is None and not self.resting):
                self.rest()  # from the drive's own trajectory, or a command from another client
            else:
                self.hold()
        elif not self.stopping and not self.resting and self.status.energised is not False:
            self.stop()
        ended, self.ended, self.gone = self.ended, None, reason
        if ended is not None:
            ended(reason)

    def stop(self) -> None:
        """Start a quick stop: brake hard, repeatedly, until the drive reports rest."""
        self._begin_stop()
        self._brake()
        self.show()

    def _begin_stop(self) -> None:
        self.mode = None
        self.stopping, self._braked_at = True, time.monotonic()
        if self.stop_began is None:
            self.stop_began = time.monotonic()

    def stop_broken(self) -> bool:
        """Stop a motor whose profile fails, as far as that goes; return whether the drive was told.

        Called at each failed tick: one that brakes already is only told again, or it would never
        count as at rest.
        """
        if not self.stopping:
            self._begin_stop()
        try:
            return self._brake()
        except Exception:
            return False

    def hold_stop(self) -> None:
        """Repeat the stop if the motor is not at rest, or if another master has enabled it."""
        if not self.met:
            self._brake()  # the drive may receive frames although its own are lost
        elif self.released and self.status.energised:
            self._release()
        elif not self.stopping and (not self.resting or self.drive.loose):
            self.stop()

    def _brake(self) -> bool:
        """Tell the drive to stop; return whether it was told, as far as a queue of frames does."""
        if not self.released:
            with unfenced():
                return self._send(self.drive.stop)
        if self.status.energised is not False:
            self._release()
        return True

    def _release(self) -> None:
        """Cut the torque after a stop, repeatedly, until the drive reports that it is off."""
        self.released, self.mode = True, None
        if self._releasing is None or self._releasing.done():
            with unfenced():
                self._releasing = asyncio.create_task(self._cut(), name=f"can {self.name} off")

    async def _cut(self) -> None:
        self.wanted_on = False
        while self.released and (self.status.energised is not False or self.blind is not None):
            try:
                await self.drive.disable()
            except RcpError as error:
                log.warning("torque_not_off", motor=self.name, error=error.message)
                await asyncio.sleep(_RETRY)
        self.show()

    def forget(self, reason: RcpError | None) -> None:
        """Discard the current set-point and notify its action of the reason."""
        self.mode, self.gone = None, reason
        ended, self.ended = self.ended, None
        if ended is not None and reason is not None:
            ended(reason)
        self.show()

    async def disable(self) -> None:
        """Switch the power stage off."""
        self.end_stop()
        self.wanted_on = False
        self.forget(ModeForbids(f"motor '{self.name}' was disabled"))
        with unfenced():
            await self.drive.disable()
        self.in_use = False

    def end_stop(self) -> None:
        """End a quick stop before a new command."""
        self.stopping, self.released, self.stop_began = False, False, None

    # Periodic work

    def tick(self, dt: float) -> None:
        """Send whatever is due; called at the motor's rate with `dt` in s."""
        self._tick += 1
        self._step_due = True
        now = time.monotonic()
        gap, self._ticked = now - self._ticked, now
        self.send_delay.advance(min(gap, self._late), self.bus.lag)
        if gap > self._frozen and (self.mode is not None or self.owner is not None):
            self._thaw(gap)
        if self.online:
            # What was received since the last tick may still be queued after a late one.
            heard = now - gap if gap > self._late else now
            if (why := loss(self, heard)) is not None:
                self._lose(why)
            else:
                self._check_feedback(stale(self, heard))
        if not self.bus.up:
            return
        if self.mode is not None and self.send_delay.seconds > STALLED:
            self._stall()
        if self.stopping:
            if self.rests_since(self._braked_at):
                self._stopped()
            else:
                self._brake()
        elif self.mode is not None and self.status.enabled:
            self._step_due = False
            self.step(dt)
        elif self.online and self._moved_by_another():
            self.stop()
        after = self.config.torque_off_after
        began = self.stop_began
        if None not in (after, began) and not self.released and now - began >= after:  # type: ignore[operator]
            self._release()
        self._send(lambda: self.drive.poll(self._tick))

    def _thaw(self, gap: float) -> None:
        """Stop the motor after the gateway process has been suspended for `gap` s."""
        text = f"the gateway did not run for {gap:.1f} s"
        self.fault("gateway_stalled", text, lasting=False)
        self.forget(AdapterUnavailable(f"motor '{self.name}': {text}, and it was stopped"))
        self.stop()

    def _moved_by_another(self) -> bool:
        moves = self.is_fresh("velocity") and not self.slow
        if not (self.drive.loose or moves) or self.status.energised is False:
            return False
        return self._host.is_latched()

    def _stopped(self) -> None:
        self.stopping = False
        if self.drive.holds and self.status.enabled and not self.released:
            began = self.stop_began
            self.rest()
            self.stop_began = began
        self.show()

    def _check_feedback(self, why: Loss | None) -> None:
        """Stop a motor whose feedback is too old, and detect when it returns."""
        was, self.blind = self.blind, why
        if was is None and why is not None:
            self.wanted_on = False
            self.drive.lose()
            self.fault(why.fault, why.text)
            self._health.report(self.name, f"motor '{self.name}': {why.text}")
            self.forget(DeviceTimeout(f"motor '{self.name}': feedback lost: {why.text}"))
            if self.status.energised is not False:
                self.stop()
            self.show()
        elif was is not None and why is None:
            self.faults.clear("feedback_lost")
            self._health.report(self.name, None)
            self.wanted_on = False
            self.show()

    def step(self, dt: float) -> None:
        """Send the next set-point of the ramp."""
        due = set_point(self, dt)
        if due is not None:
            self.drive.torque_offset = torque_offset(self)
            self._send(lambda: self.drive.command(*due))

    def _send(self, function: Callable[[], object]) -> bool:
        try:
            function()
        except RcpError as error:  # the bus state reports it; the next tick tries again
            log.debug("not_sent", motor=self.name, error=error.message)
            return False
        return True

    def _lose(self, why: Loss) -> None:
        self.online, self._lost_once, self.blind = False, True, None
        self.wanted_on = False
        self.drive.lose()
        was_on = self.status.energised is not False or self.mode is not None
        self.status.enabled = self.status.holding = None
        self.fault(why.fault, why.text)
        self._health.report(self.name, f"motor '{self.name}': {why.text}")
        self.forget(AdapterUnavailable(f"motor '{self.name}': {why.text}"))
        if was_on:  # the drive may still follow its last set-point, and still receive frames
            self.stop()

    def _stall(self) -> None:
        """Drop a set-point that cannot be sent: the ramp would run far ahead of the joint."""
        text = f"its set-points could not be sent for {STALLED:g} s: "
        if self.bus.refusing:
            text += "the bus accepts no frames"
            self.fault("not_sent", text, lasting=False)
            self.forget(QueueFull(f"motor '{self.name}': {text}"))
        else:
            text += "the gateway was too slow"
            self.fault("gateway_stalled", text, lasting=False)
            self.forget(AdapterUnavailable(f"motor '{self.name}': {text}"))
        self.stop()

    def _bus_turned(self, _was: Condition, now: Condition) -> None:
        """Discard the set-points of a lost bus, so that nothing moves when the bus returns."""
        if self.online and now in ("bus_off", "down"):
            self._lose(Loss("feedback_lost", f"CAN bus '{self.bus.name}' is {now}"))

    # Publishing

    def fault(self, name: str, text: str, *, lasting: bool = True) -> None:
        """Report a fault detected by the gateway; a lasting one is active until cleared."""
        fault = Fault(name, text)
        if lasting:
            self.faults.note(fault)
            self.show()
        else:
            self.faults.publish(fault, active=True)

    async def clear_faults(self) -> None:
        """Reset the faults of the drive, and clear those detected by the gateway.

        Nothing is sent to a drive without a fault: it may be turning.
        """
        if self.status.faults:
            with unfenced():
                await self.drive.clear_faults()
        self.faults.acknowledge()
        self.show()

    def show_health(self) -> None:
        """Publish temperatures and supply."""
        if self.online:
            self._host.publish(f"sensor/{self.name}/health", views.health(self))

    def show(self) -> None:
        """Publish the state and changes of faults, if anything changed."""
        self.faults.update(self.status.faults)
        value = views.state(self)
        if value != self._shown:
            self._shown = value
            self._host.publish(f"sensor/{self.name}/state", value)

    async def close(self) -> None:
        """Cancel the background tasks."""
        for task in (self.configuring, self._releasing):
            if task is not None:
                task.cancel()
                await asyncio.wait((task,))
