"""Whether a vehicle has restarted: by its clock, which counts from boot, and by its heartbeats, which pause."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager

from rcp_mavlink.frames import Frame
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Restart", "watched"]

_CLOCKS = ("SYSTEM_TIME", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE")
"""Messages with the time since boot."""
_OUT_OF_ORDER = 500  # ms by which a message may be older than the one before
_PAUSE = 3.0  # s without a heartbeat; one a second is sent


class Restart:
    """One restart that was commanded, as the messages of the vehicle show it."""

    def __init__(self, vehicle: Vehicle) -> None:
        known = [name for name in _CLOCKS if name in vehicle.received_at]
        last = max(known, key=vehicle.received_at.__getitem__, default=None)
        self._clock = 0 if last is None else vehicle.latest[last].fields()["time_boot_ms"]
        self._heard = time.monotonic()
        self._gone = False
        self.began_again = False
        """Whether its clock was seen to begin again."""
        self.done = False
        """Whether it was seen to go, and a heartbeat has come since."""

    def take_clock(self, frame: Frame) -> None:
        """See whether the clock began again."""
        clock = frame.fields()["time_boot_ms"]
        if clock:  # some vehicles leave it at 0
            self.began_again = self.began_again or clock + _OUT_OF_ORDER < self._clock
            self._gone = self._gone or self.began_again
            self._clock = max(clock, self._clock)

    def take_heartbeat(self, _: Frame) -> None:
        """See whether heartbeats have paused."""
        now = time.monotonic()
        self._gone = self._gone or now - self._heard >= _PAUSE
        self._heard, self.done = now, self._gone

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
