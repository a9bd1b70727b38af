"""All links and vehicles: routes frames to vehicles, and messages over the last active link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

import structlog

from rcp_kernel.errors import NotReady
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.elevation import Elevation
from rcp_mavlink.frames import Frame, Framer, rebuilt
from rcp_mavlink.links import Link
from rcp_mavlink.signing import Signing, key_of
from rcp_mavlink.texts import Texts
from rcp_mavlink.twins import STARTING, orders
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["Hub", "open_hub"]

log = structlog.get_logger("rcp.mavlink")
_BEAT = 1.0  # s between two heartbeats of the gateway
_NO_AUTOPILOT, _GROUND_STATION = 8, 6
_MOST = 255
_LATELY = 30.0  # s


class _Sink:
    def __init__(self) -> None:
        self.frame = b""

    def write(self, frame: bytes) -> None:
        self.frame = bytes(frame)


def _heard(route: tuple[Any, Any, float]) -> float:
    return route[2]


class Hub:
    """Routes between links and vehicles."""

    def __init__(
        self, config: MavlinkConfig, dialect: Dialect, elevation: Elevation | None = None
    ) -> None:
        self.config, self.dialect, self.elevation = config, dialect, elevation
        self.vehicles: dict[int, Vehicle] = {}
        self.found: Callable[[Vehicle], None] = lambda _: None
        """Called with each newly detected vehicle."""
        self.changed: Callable[[Vehicle], None] = lambda _: None
        """Called when a vehicle is lost or connected again."""
        self._untold: set[int] = set()
        """Vehicles whose last change could not be told."""
        self._complaint = ""
        self._due = 0.0
        """When the next heartbeat is sent."""
        self._first = asyncio.Event()
        simulates = any(text.startswith("sim:") for text in config.links)
        self._patience = max(config.connect, STARTING) if simulates else config.connect
        self._signing = None if config.key is None else Signing(key_of(config.key))
        self._texts = Texts()
        self._sinks: list[tuple[Any, _Sink]] = []
        self.links = [
            Link(number, text, lambda: Framer(dialect, self._signing), self._take)
            for number, text in enumerate(config.links)
        ]
        for link in self.links:
            link.joined = self.beat
            if link.spec.kind == "sim":
                link.twin = orders(config, link.number)
            sink = _Sink()
            mav = dialect.module.MAVLink(sink, config.source_system, config.source_component)
            if self._signing is not None:
                self._signing.apply(mav, link.number)
            self._sinks.append((mav, sink))

    # Receiving

    def _take(self, link: Link, address: Any, frames: list[Frame]) -> None:
        now = time.monotonic()
        for frame in frames:
            vehicle = self.vehicles.get(frame.system)
            if vehicle is None:
                vehicle = self._new(frame)
                if vehicle is None:
                    continue
            for tap in vehicle.taps:
                tap(frame)
            if frame.component != vehicle.component:
                vehicle.overhear(frame)
                continue
            vehicle.routes[link.number, address] = (link, address, now)
            if vehicle.lost:  # before the frame is processed: the stop must be sent first
                vehicle.lost = False
                self._tell(vehicle)
            if frame.definition.id == self._texts.id:
                self._texts.take(vehicle, frame)
            vehicle.take(frame, now)

    def _new(self, frame: Frame) -> Vehicle | None:
        """Return the vehicle of a first heartbeat; None if it is not relevant."""
        config = self.config
        if frame.definition.id != 0 or len(self.vehicles) >= _MOST:
            return None
        if not config.discover and (self.vehicles or config.system not in (None, frame.system)):
            return None
        beat = frame.fields()
        if beat["autopilot"] == _NO_AUTOPILOT or beat["type"] == _GROUND_STATION:
            return None
        vehicle = Vehicle(self.dialect, frame.system, frame.component)
        vehicle.take(frame, time.monotonic())
        self.vehicles[frame.system] = vehicle
        asyncio.get_running_loop().call_soon(self.found, vehicle)
        self._first.set()
        return vehicle

    # Sending

    def send(self, vehicle: Vehicle, message: Any, *, urgent: bool = False) -> None:
        """Send a message to a vehicle over its last active link; an urgent one has room on a full one.

        Where two vehicles have its system id, an urgent one goes wherever one was heard lately.
        """
        routes = list(vehicle.routes.values())
        if not routes:
            return
        last = max(routes, key=_heard)
        if urgent and vehicle.duplicated:
            ways = [route for route in routes if _heard(last) - _heard(route) < _LATELY]
        else:
            ways = [last]
        for link, address, _ in ways:
            link.send(self._packed(link, message), address, urgent=urgent)

    def is_target(self, fields: Mapping[str, Any]) -> bool:
        """Return whether a message is for this gateway, or for everybody: not for another ground station."""
        config = self.config
        own = {"target_system": config.source_system, "target_component": config.source_component}
        return all(fields.get(field, 0) in (0, number) for field, number in own.items())

    def forward(self, vehicle: Vehicle, frame: Frame) -> None:
        """Send a frame of somebody else to a vehicle, signed with `key` if there is one."""
        if vehicle.routes:
            link, address, _ = max(vehicle.routes.values(), key=lambda route: route[2])
            link.send(rebuilt(frame, self._signing, link.number), address)

    def _packed(self, link: Link, message: Any) -> bytes:
        mav, sink = self._sinks[link.number]
        mav.send(message)
        return sink.frame

    def beat(self) -> None:
        """Send a heartbeat over every link, so that vehicles detect the gateway."""
        message = self.dialect.module.MAVLink_heartbeat_message(
            _GROUND_STATION, _NO_AUTOPILOT, 0, 0, 4, 3
        )
        for link in self.links:
            link.send_all(self._packed(link, message))

    # Lifecycle

    async def run(self) -> None:
        """Send heartbeats and detect lost vehicles, until cancelled, whatever fails meanwhile."""
        told = ""
        while True:
            try:
                self._look(time.monotonic())
            except Exception as error:
                if repr(error) != told:
                    log.exception("links_failed")
                told = repr(error)
            await asyncio.sleep(min(_BEAT, self.config.silence) / 4)

    def _look(self, now: float) -> None:
        if now >= self._due:
            self._due = now + _BEAT
            self.beat()
        for vehicle in self.vehicles.values():
            silent = now - vehicle.last_message_at > self.config.silence
            if silent and not vehicle.lost and now > vehicle.away_until:
                vehicle.lose(self.silent(vehicle))
                self._untold.add(vehicle.system)
            if vehicle.system in self._untold:
                self._tell(vehicle)

    def _tell(self, vehicle: Vehicle) -> None:
        """Tell that a vehicle is lost, or connected again; at the next look again if that fails."""
        self._untold.add(vehicle.system)
        try:
            self.changed(vehicle)
        except Exception as error:
            if repr(error) != self._complaint:
                log.exception("change_of_vehicle_failed", vehicle=vehicle.system)
            self._complaint = repr(error)
        else:
            self._untold.discard(vehicle.system)

    def silent(self, vehicle: Vehicle) -> str:
        """Describe a lost vehicle, with the known causes."""
        errors = [f"{link.text}: {link.error}" for link in self.links if link.error]
        why = f" ({'; '.join(errors)})" if errors else ""
        return f"no message from vehicle {vehicle.system} for {self.config.silence:g} s{why}"

    async def first(self) -> None:
        """Wait for the first vehicle.

        :raises NotReady: no vehicle connects in time.
        """
        try:
            async with timeout(self._patience):
                await self._first.wait()
        except TimeoutError:
            which = (
                "no vehicle" if self.config.system is None else f"no vehicle {self.config.system}"
            )
            errors = [f"{link.text}: {link.error}" for link in self.links if link.error]
            stats = [link.framer.stats for link in self.links]
            if (rejected := sum(s.unsigned + s.rejected for s in stats)) > 0:
                errors.append(f"{rejected} messages were not signed with `key`")
            where = "; ".join(errors) or ", ".join(self.config.links)
            raise NotReady(f"{which} is connected ({where})") from None


@asynccontextmanager
async def open_hub(config: MavlinkConfig, dialect: Dialect) -> AsyncGenerator[Hub]:
    """Open the links while entered.

    :raises ConfigError: the folder `terrain` does not exist.
    :raises NotReady: a port to listen on is in use.
    """
    elevation = None if config.terrain is None else Elevation(config.terrain)
    hub = Hub(config, dialect, elevation)
    running: asyncio.Task[None] | None = None
    try:
        for link in hub.links:
            try:
                await link.open()
            except OSError as error:
                raise NotReady(f"{link.text}: {error}") from error
        running = asyncio.create_task(hub.run())
        yield hub
    finally:
        if running is not None:
            running.cancel()
            with suppress(asyncio.CancelledError):
                await running
        for link in hub.links:
            await link.close()
        if elevation is not None:
            elevation.close()
