"""The links: ground stations on one side, a session of the gateway on the other."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any

import msgspec
import structlog

from rcp_gateway.api import Connection
from rcp_gateway.client_api import ClientApi
from rcp_ground_stations.answers import Answers, Refusal
from rcp_ground_stations.config import GroundStationsConfig, StationConfig
from rcp_ground_stations.pilot import Pilot
from rcp_kernel.errors import AdapterUnavailable, ConfigError, RcpError
from rcp_kernel.values import Encoding
from rcp_mavlink.dialect import Dialect, dialect
from rcp_mavlink.frames import Frame, Framer, rebuilt
from rcp_mavlink.links import Link
from rcp_mavlink.signing import Signing, key_of

__all__ = ["open_stations"]

log = structlog.get_logger("rcp.ground_stations")
_DEPTH = 256  # frames that may wait for ground stations
_BEAT = 0
_AGAIN = 5.0  # s until a key that was refused is tried again
_FORGET = 60.0  # s without a genuine frame after which nothing more is sent to an address
_STATIONS = 16  # at one link
_CALLING = ("udpout", "tcp", "serial")


class Station:
    """One link."""

    def __init__(self, config: StationConfig, client_api: ClientApi, messages: Dialect) -> None:
        self._config, self._client_api = config, client_api
        self._signing = None if config.key is None else Signing(key_of(config.key))
        self._framer = Framer(messages, None)
        self.link = Link(0, config.link, lambda: Framer(messages, self._signing), self._take)
        self._connection = self._connected()
        self._answers = Answers(messages, self._signing)
        self._pilot = Pilot(config, client_api, self._connection.session, self._refused)
        self._vehicle = 1
        self._again: asyncio.TimerHandle | None = None
        self._resubscribing: asyncio.TimerHandle | None = None
        self._known: dict[Any, float] = {}
        """Addresses of ground stations, and when each sent its last genuine frame."""
        self._tasks: list[asyncio.Task[None]] = []

    def _connected(self) -> Connection:
        """Open a session with the rights that the key has now.

        :raises RcpError: it is not known, or has no role in the tenant.
        """
        principal = self._client_api.authenticate(self._config.token)
        tenant = self._config.robot.split("/")[2]
        return self._client_api.connect(principal, Encoding.MSGPACK, self._flush, tenant)

    async def open(self) -> None:
        """Open the link and follow the vehicle.

        :raises OSError: a port to listen on is not available.
        """
        await self.link.open()
        self._tasks.append(self._client_api.loop.create_task(self._pilot.run()))
        self._subscribe()

    async def close(self) -> None:
        """Give control back and close the link."""
        for timer in (self._again, self._resubscribing):
            if timer is not None:
                timer.cancel()
        for task in self._tasks:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        await self._pilot.release()
        self._connection.close()
        await self.link.close()

    # From the gateway

    def _subscribe(self) -> None:
        if self._resubscribing is not None:
            self._resubscribing.cancel()
            self._resubscribing = None
        request = {
            "type": "subscribe",
            "id": "frames",
            "path": self._config.path("event", "mavlink/*"),  # also of a vehicle that comes later
            "body": {"qos": {"depth": _DEPTH}},
        }
        self._connection.receive(msgspec.msgpack.encode(request))

    def _reconnect(self) -> None:
        """Begin anew: the session has ended, because the key was revoked, changed or has expired."""
        self._again = None
        try:
            self._connection = self._connected()
        except RcpError as error:
            log.warning("ground_station_refused", link=self._config.link, reason=str(error))
            self._again = self._client_api.loop.call_later(_AGAIN, self._reconnect)
            return
        self._pilot.session = self._connection.session
        self._subscribe()

    def _flush(self) -> None:
        if self._connection.expelled:
            if self._again is None:
                self._connection.close()
                self._again = self._client_api.loop.call_later(_AGAIN, self._reconnect)
            return
        outbox = self._connection.outbox
        for message in outbox.collect():
            self._hear(msgspec.msgpack.decode(message))
        outbox.again()

    def _hear(self, message: dict[str, Any]) -> None:
        match message.get("type"):
            case "update":
                self._forward(message["body"])
            case "subscribe" if message.get("error") is not None:
                log.warning(
                    "vehicle_not_followed",
                    robot=self._config.robot,
                    reason=message["error"]["message"],
                )
                # It may be allowed later: by a condition of its role, or when there is room.
                self._resubscribing = self._client_api.loop.call_later(_AGAIN, self._subscribe)
            case _:
                pass

    def _forward(self, body: dict[str, Any]) -> None:
        data: bytes = body["data"]
        self._vehicle = body["system"]
        if self._signing is not None or (data[0] == 0xFD and data[2]):
            self._framer.reset()
            found = self._framer.datagram(data)
            if not found:  # of another dialect than the station's
                return
            data = rebuilt(found[0], self._signing, 0)
        self._send(data)

    def _send(self, data: bytes) -> None:
        """Send to those who have shown that they are ground stations, or whom the link calls."""
        if self.link.spec.kind in _CALLING:
            self.link.send_all(data)
            return
        old = self._client_api.loop.time() - _FORGET
        for address, at in self._known.items():
            if at > old:
                self.link.send(data, address)

    # From ground stations

    def _take(self, _link: Link, address: Any, frames: list[Frame]) -> None:
        if frames:
            self._known.pop(address, None)
            if len(self._known) >= _STATIONS:  # the one that was silent longest goes
                del self._known[next(iter(self._known))]
            self._known[address] = self._client_api.loop.time()
        for frame in frames:
            # The vehicle has the gateway's own heartbeat: its failsafe watches the gateway.
            if frame.definition.id != _BEAT:
                self._pilot.take(frame)

    def _refused(self, frame: Frame, refusal: Refusal) -> None:
        now = self._client_api.loop.time()
        for answer in self._answers.of(frame, refusal, self._vehicle, now):
            self._send(answer)


@asynccontextmanager
async def open_stations(
    config: GroundStationsConfig, client_api: ClientApi
) -> AsyncGenerator[dict[str, Any]]:
    """Serve ground stations while entered.

    :raises ConfigError: a key is not known.
    :raises AdapterUnavailable: a port is not available.
    """
    async with AsyncExitStack() as stack:
        links: dict[str, str] = {}
        for name, one in config.stations.items():
            messages = await asyncio.to_thread(dialect, one.dialect)
            where = f"plugins.ground_stations.stations.{name}"
            try:
                station = Station(one, client_api, messages)
            except RcpError as error:
                raise ConfigError(f"{where}: `token`: {error}") from error
            stack.push_async_callback(station.close)
            try:
                await station.open()
            except OSError as error:
                raise AdapterUnavailable(f"{where}: {one.link}: {error}") from error
            links[name] = one.link
        yield links
