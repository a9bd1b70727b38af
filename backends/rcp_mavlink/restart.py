"""Restarts: commanded, and seen by the clock, which counts from boot, or by heartbeats that pause."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed, RcpError
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Restart", "Restarts", "one_boot", "watched"]

_CLOCKS = ("SYSTEM_TIME", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE")
"""Messages with the time since boot."""
_OUT_OF_ORDER = 500  # ms by which a message may be older than the one before
_REBOOT, _REQUEST = 246, 512  # MAV_CMD
_RESTING = 5.0  # s to come to rest before the motors are stopped
_COMING_BACK = 30.0  # s for a reboot
_SYSTEM_TIME, _ASKING = 2.0, 0.5  # a message with its clock, and s between requests for it
_PAUSE = 3.0  # s without a heartbeat; one a second is sent
_TOLD = 3.0  # s for a message with its clock


class Restart:
    """Whether a vehicle restarts, as its messages show it."""

    def __init__(self, vehicle: Vehicle) -> None:
        known = [name for name in _CLOCKS if name in vehicle.received_at]
        last = max(known, key=vehicle.received_at.__getitem__, default=None)
        self._clock = 0 if last is None else vehicle.latest[last].fields()["time_boot_ms"]
        self._heard = time.monotonic()
        self.clock_at = float("-inf")
        """When its clock was last heard, on the monotonic clock."""
        self._gone = False
        self.began_again = False
        """Whether its clock was seen to begin again."""
        self.done = False
        """Whether it was seen to go, and a heartbeat has come since."""

    def take_clock(self, frame: Frame) -> None:
        """See whether the clock began again."""
        clock = frame.fields()["time_boot_ms"]
        if clock:  # some vehicles leave it at 0
            self.clock_at = time.monotonic()
            self.began_again = self.began_again or clock + _OUT_OF_ORDER < self._clock
            self._gone = self._gone or self.began_again
            self._clock = max(clock, self._clock)

    def take_heartbeat(self, _: Frame) -> None:
        """See whether heartbeats have paused."""
        now = time.monotonic()
        self._gone = self._gone or now - self._heard >= _PAUSE
        self._heard, self.done = now, self._gone

    @property
    def has_clock(self) -> bool:
        """Whether it has told its clock at all."""
        return self._clock > 0

    def overlook_pause(self) -> None:
        """Take a pause of the heartbeats for one of the link."""
        self._gone = self.done = self.began_again


@contextmanager
def watched(vehicle: Vehicle) -> Generator[Restart]:
    """Watch for a restart while entered."""
    restart = Restart(vehicle)
    with ExitStack() as stack:
        for name in _CLOCKS:
            stack.enter_context(vehicle.listening(name, restart.take_clock))
        stack.enter_context(vehicle.listening("HEARTBEAT", restart.take_heartbeat))
        yield restart


@asynccontextmanager
async def one_boot(vehicle: Vehicle, commands: Commands, what: str) -> AsyncGenerator[Restart]:
    """Watch that a vehicle does not restart while entered.

    After a restart in the air it says that it is disarmed and on the ground.

    :raises DeviceTimeout: it restarted, or its clock does not show that it did not.
    """
    with watched(vehicle) as restart:
        try:
            yield restart
        except DeviceRejected:
            if restart.began_again:
                raise _restarted(what) from None
            raise
        at = time.monotonic()
        with suppress(RcpError, OSError):  # most send it unasked
            commands.send_once(Command(_REQUEST, (_SYSTEM_TIME, 0.0, 0.0, 0.0)))

        def is_told() -> bool:
            return restart.began_again or restart.clock_at > at or not restart.has_clock

        told = await vehicle.until(is_told, _TOLD)
        if restart.began_again:
            raise _restarted(what)
        if not told:
            raise DeviceTimeout(
                f"{what}: the vehicle's clock does not show that it has not restarted"
            )


def _restarted(what: str) -> DeviceTimeout:
    return DeviceTimeout(
        f"{what}: the vehicle restarted meanwhile: what it reports proves nothing",
        remedy="Look where it is before you command it again.",
    )


class Restarts:
    """Reboots one vehicle; `back` is called when it has restarted."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        motion: Motion,
        *,
        end_setpoints: Callable[[], None],
        back: Callable[[], None],
    ) -> None:
        self._vehicle, self._commands, self._motion = vehicle, commands, motion
        self._end_setpoints, self._back = end_setpoints, back

    async def reboot(self) -> None:
        """Reboot the vehicle; completes when it has restarted and its heartbeats return.

        :raises DeviceTimeout: it was not seen to restart, or has not come back.
        """
        vehicle = self._vehicle
        with watched(vehicle) as restart:
            await self._commands.send(Command(_REBOOT, (1.0, 0.0, 0.0, 0.0)), "reboot")
            end = vehicle.away_until = time.monotonic() + _COMING_BACK
            try:  # it goes on for a while after it has accepted
                while not await vehicle.until(lambda: restart.done, _ASKING):
                    if time.monotonic() > end:
                        raise DeviceTimeout("reboot: accepted, but the vehicle has not restarted")
                    self._commands.send_once(Command(_REQUEST, (_SYSTEM_TIME, 0.0, 0.0, 0.0)))
            finally:
                vehicle.away_until = 0.0
        self._back()

    async def reset(self, _: None, progress: Progress) -> None:
        """Stop, disarm and reboot the vehicle.

        :raises PreconditionFailed: it may be in the air, where a reboot would make it fall.
        """
        vehicle = self._vehicle
        measurement = self._motion.measurement
        if vehicle.family.flies and not (measurement.disarmed or measurement.standing):
            raise PreconditionFailed("reset: the vehicle is in the air", remedy="Land it first.")
        self._end_setpoints()
        if vehicle.armed:
            await self._motion.hold()
            await vehicle.until(lambda: self._motion.rests, _RESTING)
            await self._motion.disarm(None, progress)
        await self.reboot()
