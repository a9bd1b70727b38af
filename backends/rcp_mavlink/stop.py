"""The stop of one vehicle: steps in sequence, each commanded until telemetry confirms it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from rcp_kernel.errors import DeviceTimeout, EstopActive, NotImplementedByRobot
from rcp_kernel.spi import MotionState, check_fence, unfenced
from rcp_mavlink.commands import Command, Commands, mode_command
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.ladder import LOITER, Group, Rung, ladder
from rcp_mavlink.measurement import SETTLED, Measurement
from rcp_mavlink.vehicle import Vehicle

__all__ = ["PAUSE_PX4", "Stop"]

log = structlog.get_logger("rcp.mavlink")
_FORCE = 21196.0
_NAN = math.nan
PAUSE_PX4 = Command(192, (-1.0, 1.0, 0.0, _NAN), _NAN, _NAN, _NAN)
"""DO_REPOSITION without a position: PX4 goes to targets in HOLD, which HOLD alone would not end."""

_AGAIN = 0.2  # s between repetitions without a response
_QUICKEST = 0.05  # s, minimum interval
_REMIND = 0.25  # s between checks of its mode while at rest, in case of another commander
_BLINDLY = 1.0  # s between repetitions to a lost vehicle
_FRESH = 0.2  # s for which a heartbeat counts as the present mode
_ANSWER = 0.4  # s for a requested heartbeat to arrive
_RESTART = 1.0  # s after a failed run, until `hold_stop` starts another
_TAKEN = 2.0  # s for telemetry to show the mode
_REFUSALS = 2  # one alone may be the late reply to the previous step
_LATE_ANSWERS = 0.1  # s for late replies, and the reasons as text
_LEVEL = 3.0  # s for a mode without a position to show that it holds
_LANDING = 600.0  # s
_DISARMING = 2.0  # s for a vehicle on the ground to disarm when commanded
_FORGOTTEN = 2.0  # s without a call, after which the next stop starts at the first step
_POLL_PERIOD = 0.05  # s
_ARM, _TERMINATE, _LOITER, _REQUEST = 400, 185, 17, 512
_POSITION, _HEARTBEAT = 33.0, 0.0
_ACCEPTED, _IN_PROGRESS = 0, 5
_STAND = Command(_ARM)
_FALL = Command(_ARM, (0.0, _FORCE, 0.0, 0.0))


class _Attempt:
    """The progress of one step of a stop."""

    def __init__(self, rung: Rung, *, pause: bool) -> None:
        self.rung, self.pause = rung, pause
        self.began = self.waits = time.monotonic()
        """Start time of the step, and since when its mode is not in effect."""
        self.taken: float | None = None
        """Since when telemetry shows its mode."""
        self.was_free = False
        """Whether the vehicle was in another mode before, which may have set it in motion."""
        self.at_rest_since: float | None = None
        """Since when the vehicle is on the ground."""
        self.refusals = 0


class Stop:
    """Brings one vehicle to rest and keeps it there."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        commands: Commands,
        measurement: Measurement,
        *,
        end_setpoints: Callable[[], None],
        beside: Callable[[], MotionState | None],
        latched: Callable[[], bool],
    ) -> None:
        self._hub, self._vehicle, self._commands = hub, vehicle, commands
        self._measurement = measurement
        self._end_setpoints, self._beside, self._latched = end_setpoints, beside, latched
        self._task: asyncio.Task[None] | None = None
        self._at = 0
        """Index of the present step: the previous ones were refused or ineffective."""
        self._tried: list[str] = []
        self._called = self._sent = self._requested = self._failed = -math.inf
        self._shown = -math.inf
        """Earlier heartbeats prove nothing."""
        self._was_latched = False
        self._taken = False
        """Whether a step has been in effect since the stop began."""
        self._complained = ""
        self._unsure: float | None = None

    # State

    @property
    def running(self) -> bool:
        """Whether a stop is in progress."""
        return self._task is not None and not self._task.done()

    @property
    def rung(self) -> Rung:
        """The step in effect, or otherwise the first."""
        rungs = self._rungs()
        return rungs[min(self._at, len(rungs) - 1)] if self.in_force else rungs[0]

    @property
    def in_force(self) -> bool:
        """Whether a stop is in progress or maintained."""
        return self.running or time.monotonic() - self._called <= _FORGOTTEN

    def state(self) -> MotionState:
        """Report whether it is at rest as the stop requires; without one, whether it is still.

        What moves beside the flight counts too.
        """
        found, beside = self._flight(), self._beside()
        if beside is None or found.at_rest is False:
            return found
        return MotionState(beside.at_rest, beside.detail, found.energised)

    def _flight(self) -> MotionState:
        if not self.in_force:
            return self._measurement.rest(LOITER)
        found = self._measurement.rest(self.rung)
        if not self._tried:
            return found
        detail = f"{found.detail} ({'; '.join(self._tried)})"
        return MotionState(found.at_rest, detail, found.energised)

    def _rungs(self) -> list[Rung]:
        config = self._hub.config
        groups: list[Group] = [config.estop, *config.estop_fallback]
        if config.estop_terminate:
            groups.append("terminate")
        vehicle = self._vehicle
        # The standard command for autopilots with unknown modes.
        return ladder(groups, vehicle.family, hovering=vehicle.hovering) or [LOITER]

    # The e-stop

    async def halt(self) -> None:
        """Stop it; return once it is measured at rest.

        :raises AdapterUnavailable: the vehicle is lost; the stop is sent nevertheless.
        :raises DeviceTimeout: it is not at rest in time, or its motion cannot be measured.
        """
        await asyncio.shield(self.begin())

    def begin(self) -> asyncio.Task[None]:
        """Send the stop at once; return the task that brings the vehicle to rest."""
        now = time.monotonic()
        self._note_call(now)
        with unfenced():
            self._end_setpoints()
            if not self.running:
                self._shown = now
                self._was_latched = False
                self._send(self.rung)
                self._task = asyncio.get_running_loop().create_task(self._run())
                self._task.add_done_callback(self._ended)
            elif now - self._sent >= _QUICKEST and not self._rests():
                self._send(self.rung)
        assert self._task is not None
        return self._task

    def hold_stop(self) -> None:
        """Send what maintains the stop, if due; called ten times per second."""
        now = time.monotonic()
        self._note_call(now)
        if self._beside() is not None:
            with unfenced():
                self._end_setpoints()
        if self.running and not self._doubtful():
            return
        with unfenced():
            if self._vehicle.lost:
                # The uplink may work although the downlink does not.
                if now - self._sent >= _BLINDLY and self._vehicle.may_be_armed:
                    self._send(self.rung)
            elif self._doubtful() or self._flight().at_rest is not True:
                if now - self._failed >= _RESTART or self._doubtful():
                    self.begin()
            elif self._vehicle.armed and self._measurement.standing:
                if now - self._sent >= _AGAIN:
                    self._send(self.rung)
            elif self._vehicle.armed and now - self._requested >= _REMIND:
                self._request(_HEARTBEAT)

    def doubt(self) -> None:
        """Discard the known state: the vehicle was lost for a while."""
        self._measurement.doubtful_since = time.monotonic()
        self._sent = -math.inf

    def _doubtful(self) -> bool:
        """Return whether it is connected again, but has not been sent the stop since."""
        return not self._vehicle.lost and self._sent < self._measurement.doubtful_since

    def _note_call(self, now: float) -> None:
        if now - self._called > _FORGOTTEN and not self.running:
            self._at = 0
            self._tried.clear()
            self._taken = False
        self._called = now

    async def close(self) -> None:
        """Cancel the task; commands already sent remain in effect on the vehicle."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def _ended(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._failed = time.monotonic()
            if str(error) != self._complained:
                log.warning("vehicle_not_stopped", vehicle=self._vehicle.system, error=str(error))
        self._complained = "" if error is None else str(error)

    async def _run(self) -> None:
        rungs = self._rungs()
        at, tried = await self._climb(rungs, min(self._at, len(rungs) - 1), self._reached)
        if at is None:
            self._at = 0  # start over: what was refused earlier may be accepted now
            raise DeviceTimeout(f"vehicle {self._vehicle.system}: {'; '.join(tried)}")
        await self._all_over()
        if tried:
            log.warning(
                "vehicle_stopped_by_fallback",
                vehicle=self._vehicle.system, step=rungs[at].word, tried=tried,
            )  # fmt: skip
        else:
            log.info("vehicle_stopped", vehicle=self._vehicle.system, step=rungs[at].word)

    async def _all_over(self) -> None:
        """Wait for what moves beside the flight.

        :raises DeviceTimeout: it is not seen to stop.
        """
        await self._vehicle.until(lambda: self._beside() is None, self._hub.config.estop_timeout)
        if (beside := self._beside()) is not None:
            raise DeviceTimeout(f"vehicle {self._vehicle.system}: {beside.detail}")

    def _reached(self, at: int, tried: Sequence[str]) -> None:
        self._at = at
        self._tried = list(tried)

    # Hold without an e-stop

    async def hold(self) -> None:
        """Hold its position without an e-stop, only in the air; raises like `halt`."""
        if self._latched() or self.running:
            await self.halt()
            return
        check_fence()
        self._vehicle.check()
        self._end_setpoints()
        if self._measurement.disarmed or (
            self._measurement.has_heartbeat and self._measurement.standing
        ):
            return
        family = self._vehicle.family
        rungs = ladder(("hold", "level"), family, hovering=self._vehicle.hovering)
        if not rungs:
            raise NotImplementedByRobot(f"a {family.kind} has no holding mode")
        self._shown = time.monotonic()
        at, tried = await self._climb(rungs, 0, lambda *_: None, pause=True)
        if at is None:
            raise DeviceTimeout(f"vehicle {self._vehicle.system}: {'; '.join(tried)}")

    # Steps

    async def _climb(
        self,
        rungs: Sequence[Rung],
        at: int,
        reached: Callable[[int, Sequence[str]], None],
        *,
        pause: bool = False,
    ) -> tuple[int | None, list[str]]:
        """Try the steps in order; return the successful one, if any, and the failures."""
        tried = list(self._tried) if at else []
        while at < len(rungs):
            reached(at, tried)
            rung = rungs[at]
            attempt = _Attempt(rung, pause=pause)
            why = await self._try(attempt)
            if not why:
                return at, tried
            tried.append(f"{rung.word}: {why}")
            log.warning("stop_step_failed", vehicle=self._vehicle.system, step=rung.word, why=why)
            at += 1
            if attempt.refusals >= _REFUSALS:
                continue
            # The mode was accepted but ineffective: another mode of the group is no better, and
            # without its position the vehicle would only drift.
            useless = {rung.group}
            if rung.group == "hold" and self._measurement.estimated:
                useless.add("level")
            while at < len(rungs) and rungs[at].group in useless:
                at += 1
        return None, tried

    async def _try(self, attempt: _Attempt) -> str:
        """Command a step until telemetry shows rest; otherwise return why it failed.

        :raises AdapterUnavailable: the vehicle is lost.
        :raises DeviceTimeout: it does not execute the step, or its state cannot be observed.
        """
        vehicle, number = self._vehicle, _command(attempt.rung, self._vehicle).number

        def take(frame: Frame) -> None:
            ack = frame.fields()
            own = self._hub.is_target(ack)
            if own and ack["command"] == number and ack["result"] not in (_ACCEPTED, _IN_PROGRESS):
                attempt.refusals += 1

        attempt.was_free = vehicle.mode != attempt.rung.mode
        with vehicle.listening("COMMAND_ACK", take):
            while True:
                vehicle.check()
                self._check_wanted(pause=attempt.pause)
                if (why := self._check(attempt, time.monotonic())) is not None:
                    return why
                if attempt.refusals >= _REFUSALS:
                    return await self._reasons(attempt.began)
                before = self._signature(attempt)
                await vehicle.until(lambda b=before: self._signature(attempt) != b, _POLL_PERIOD)

    def _check(self, attempt: _Attempt, now: float) -> str | None:
        """Advance a step by the known state; return an empty text at rest, or why it failed."""
        rung = attempt.rung
        if self._shown_disarmed():
            return ""
        if self._standing():
            attempt.at_rest_since = attempt.at_rest_since or now
            if attempt.pause or now - attempt.at_rest_since > _DISARMING:
                return ""
            self._send_due(now, rung)
            return None
        attempt.at_rest_since = None
        if self._lands_itself(rung):
            attempt.waits, attempt.taken = now, None
            return None
        if self._in_force(rung):
            attempt.refusals = 0
            if attempt.taken is None:
                attempt.taken, self._taken = now, self._taken or not attempt.pause
                self._request(_POSITION)
            # The mode before may have just moved it, so that it moves on for a while.
            since = attempt.taken + SETTLED if attempt.was_free else attempt.taken
            if now >= since and self._rests(rung, since=since):
                return ""
            return self._too_long(rung, now - attempt.taken)
        if attempt.taken is not None:
            attempt.waits, attempt.taken = now, None
        if now - attempt.waits > _TAKEN:
            raise DeviceTimeout(f"{rung.word}: not confirmed by the vehicle")
        self._send_due(now, rung, at_once=attempt.refusals > 0)
        return None

    def _check_wanted(self, *, pause: bool) -> None:
        """Abort a stop whose latch was reset, and a hold that a stop has replaced."""
        if pause:
            check_fence()
            if self.running:
                raise EstopActive("the vehicle was stopped in the meantime")
            return
        latched = self._latched()
        if self._was_latched and not latched:
            raise DeviceTimeout("the e-stop was reset before the vehicle was at rest")
        self._was_latched = latched

    def _signature(self, attempt: _Attempt) -> tuple[Any, ...]:
        """Return the state whose changes require a check."""
        v = self._vehicle
        return v.armed, v.mode_number, v.landed, attempt.refusals, v.received_at.get("HEARTBEAT")

    async def _reasons(self, since: float) -> str:
        await asyncio.sleep(_LATE_ANSWERS)
        texts = self._vehicle.texts_since(since)
        return f"refused ({texts[-1]})" if texts else "refused"

    def _too_long(self, rung: Rung, seconds: float) -> str | None:
        """Return why a step in effect has failed; None while it may still succeed.

        :raises DeviceTimeout: it may be effective but is not observable: another is no better.
        """
        measurement = self._measurement
        if rung.rests == "landed":
            most = _LANDING
        elif rung.group == "level":
            most = _LEVEL if measurement.speed is None else self._hub.config.estop_timeout
        else:
            most = self._hub.config.estop_timeout
            if not measurement.estimated:  # it cannot hold without an estimate
                most = min(most, _LEVEL)
        if seconds <= most:
            return None
        detail = measurement.rest(rung).detail
        if rung.group == "hold" and measurement.estimated and measurement.speed is None:
            raise DeviceTimeout(f"{rung.word} is active, but {detail}")
        return f"after {seconds:.0f} s: {detail}"

    # Evidence

    def _shown_disarmed(self) -> bool:
        return self._measurement.disarmed and self._heartbeat_counts()

    def _standing(self) -> bool:
        return self._measurement.standing and self._heartbeat_counts()

    def _heartbeat_counts(self) -> bool:
        return self._vehicle.received_at.get("HEARTBEAT", -math.inf) > self._shown

    def _in_force(self, rung: Rung) -> bool:
        shown = self._measurement.has_heartbeat and self._heartbeat_counts()
        return shown and bool(rung.mode) and self._vehicle.mode == rung.mode

    def _lands_itself(self, rung: Rung) -> bool:
        """Return whether it began to land after the stop, with an empty battery for example.

        If the stop held it in the air, it would fall eventually.
        """
        held = self._taken and rung.group in ("hold", "level")
        land = self._vehicle.family.land
        return (
            held and bool(land) and self._vehicle.mode == land and self._measurement.has_heartbeat
        )

    def _rests(self, rung: Rung | None = None, since: float = -math.inf) -> bool:
        rung = rung or self.rung
        state = self._measurement.rest(rung)
        measured = rung.rests != "still" or self._measurement.measured_since(since)
        return state.at_rest is True and measured

    # Sending

    def _send_due(self, now: float, rung: Rung, *, at_once: bool = False) -> None:
        if now - self._sent >= (_QUICKEST if at_once else _AGAIN):
            self._send(rung)

    def _send(self, rung: Rung) -> None:
        """Send a step once, and request the vehicle's state.

        A disarmed vehicle is only queried: a flight mode would outlast the stop.
        """
        vehicle, now = self._vehicle, time.monotonic()
        armed = vehicle.may_be_armed
        if armed and self._needs_mode_first(now):
            self._request(_HEARTBEAT)
            return
        self._sent = now
        if armed and not self._lands_itself(rung):
            standing = self._measurement.standing
            command = _STAND if standing else _command(rung, vehicle)
            self._commands.send_once(command, urgent=True)
            if not standing and vehicle.family.px4 and rung.group == "hold":
                self._commands.send_once(PAUSE_PX4, urgent=True)
            if rung.group == "terminate":
                self._commands.send_once(_FALL, urgent=True)
        self._request(_HEARTBEAT)

    def _needs_mode_first(self, now: float) -> bool:
        """Return whether its mode must be known first: it may have begun to land by itself.

        Only after the stop was in effect, and not for long, because it may not respond.
        """
        if not self._taken or self._vehicle.lost or self._doubtful():
            return False
        if self._measurement.age("HEARTBEAT") < _FRESH:
            self._unsure = None
            return False
        if self._unsure is None:
            self._unsure = now
        return now - self._unsure < _ANSWER

    def _request(self, message: float) -> None:
        self._requested = time.monotonic()
        self._commands.send_once(Command(_REQUEST, (message, 0.0, 0.0, 0.0)), urgent=True)


def _command(rung: Rung, vehicle: Vehicle) -> Command:
    match rung.group:
        case "disarm":
            return _FALL
        case "terminate":
            return Command(_TERMINATE, (1.0, 0.0, 0.0, 0.0))
        case _ if not rung.mode:
            return Command(_LOITER)
        case _:
            return mode_command(vehicle.family, rung.mode)
