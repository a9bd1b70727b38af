"""What a vehicle's messages become in the tree: published, read, and watched."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any

from rcp_kernel.errors import DeviceTimeout, RcpError
from rcp_kernel.spi import Host
from rcp_mavlink.clock import Clock
from rcp_mavlink.derived import Derived, DerivedFrame, deriveds
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.sensors import Sensor, sensors
from rcp_mavlink.vehicle import Vehicle

__all__ = ["TIMED", "Telemetry"]

TIMED = (2, 111)
"""Messages with the vehicle's time: SYSTEM_TIME, TIMESYNC."""
_TIMED_AT_FIRST, _TIMED_EVERY = 5, 10
"""Polls: the time is requested at each of the first, then at every so many."""


class Telemetry:
    """The sensors of one vehicle: one message each, or several that belong together.

    `name` makes the path in the tree of one of the vehicle's own paths; `start` runs what nobody waits for.
    """

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        intervals: Intervals,
        host: Host,
        *,
        name: Callable[[str], str],
        start: Callable[[Coroutine[Any, Any, None]], None],
    ) -> None:
        self._hub, self._vehicle, self._intervals, self._host = hub, vehicle, intervals, host
        self._start = start
        found = sensors(hub.dialect, hub.config.messages, px4=vehicle.family.px4)
        self._sensors = {sensor.name: sensor for sensor in found}
        self._deriveds = {one.name: one for one in deriveds(hub.dialect)}
        self._watched: dict[str, int] = {}
        """Number of subscribers by message name."""
        self._paths: dict[int, list[tuple[str, bool]]] = {}
        for sensor in self._sensors.values():
            number = hub.dialect.by_name[sensor.message].id
            self._paths.setdefault(number, []).append((name(sensor.name), sensor.live))
        self._derived_paths: dict[int, list[tuple[str, Derived]]] = {}
        for one in self._deriveds.values():
            number = hub.dialect.by_name[one.messages[0]].id
            self._derived_paths.setdefault(number, []).append((name(one.name), one))
        self._clock = Clock()
        self._polls = 0

    @property
    def sensors(self) -> list[Sensor]:
        """Those that are one message each."""
        return list(self._sensors.values())

    @property
    def deriveds(self) -> list[Derived]:
        """Those that are made of several messages."""
        return list(self._deriveds.values())

    def frame(self, frame: Frame) -> None:
        """Publish what a message is or completes."""
        number = frame.definition.id
        paths = self._paths.get(number)
        if paths is not None:
            watched, at = frame.definition.name in self._watched, self._clock.of(frame)
            for name, live in paths:
                if live or watched:
                    self._host.publish(name, frame, at)
        if number in self._derived_paths:
            self._derive(frame)

    def _derive(self, frame: Frame) -> None:
        """Publish what is made of a message and the latest of others."""
        latest, watched = self._vehicle.latest, frame.definition.name in self._watched
        for name, one in self._derived_paths[frame.definition.id]:
            if (one.live or watched) and latest.keys() >= set(one.messages):
                at = self._clock.of(frame)
                self._host.publish(name, DerivedFrame(one, latest, at), at)

    # The vehicle's time

    def timed(self, frame: Frame) -> None:
        """Take one of the messages with the vehicle's time."""
        f = frame.fields()
        if "tc1" in f:
            self._clock.on_reply(f["tc1"], f["ts1"])
        else:
            self._clock.on_system_time(f["time_unix_usec"], f["time_boot_ms"])

    def request_time(self) -> None:
        """Request the vehicle's time now."""
        module = self._hub.dialect.module
        if "TIMESYNC" in self._hub.dialect.by_name and not self._vehicle.lost:
            request = module.MAVLink_timesync_message(0, self._clock.request())
            self._hub.send(self._vehicle, request)

    def poll(self) -> None:
        """Request the time now and then; called periodically."""
        if self._polls < _TIMED_AT_FIRST or self._polls % _TIMED_EVERY == 0:
            self.request_time()
        self._polls += 1

    def forget_time(self) -> None:
        """Begin its clock anew: it has rebooted."""
        self._clock.forget()

    # Reads and subscriptions

    def has(self, name: str) -> bool:
        """Tell whether one of the vehicle's own paths is a message, or made of some."""
        return name in self._sensors or name in self._deriveds

    async def read(self, name: str) -> Any:
        """Return a value of which each message was sent after the read began.

        :raises DeviceTimeout: a message does not come.
        """
        latest = self._vehicle.latest
        if name in self._sensors:
            message = self._sensors[name].message
            await self._fresh((message,))
            return latest[message].decode()
        derived = self._deriveds[name]
        await self._fresh(derived.messages)
        at = self._clock.of(latest[derived.messages[0]])
        return DerivedFrame(derived, latest, at).decode()

    async def _fresh(self, messages: tuple[str, ...]) -> None:
        since = time.monotonic()
        for message in messages:
            await self._intervals.request(message)
        for message in messages:
            fresh = await self._vehicle.until(
                lambda message=message: (
                    self._vehicle.received_at.get(message, float("-inf")) >= since
                ),
                self._hub.config.timeout,
            )
            if not fresh:
                raise DeviceTimeout(f"the vehicle did not send {message}")

    @asynccontextmanager
    async def watched(self, name: str, rate: float) -> AsyncGenerator[None]:
        """Request the messages of a path at a rate while entered."""
        messages = self._messages(name)
        unwants: list[Callable[[], None]] = []
        for message in messages:
            self._watched[message] = self._watched.get(message, 0) + 1
            unwants.append(self._intervals.want(message, rate))
            self._start(self.first(message))
        try:
            yield
        finally:
            for message, unwant in zip(messages, unwants, strict=True):
                unwant()
                self._watched[message] -= 1
                if not self._watched[message]:
                    del self._watched[message]

    def _messages(self, name: str) -> tuple[str, ...]:
        if name in self._sensors:
            return (self._sensors[name].message,)
        derived = self._deriveds.get(name)
        return () if derived is None else derived.messages

    async def first(self, message: str) -> None:
        """Request the first value at once, for messages that are rare."""
        with suppress(RcpError):
            await self._intervals.request(message)
