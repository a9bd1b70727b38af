"""The robots at their broker: each with a connection and a last will of its own.

A thread of paho's serves each connection, and connects again when it is lost. Nothing of a robot is
touched in it.
"""

from __future__ import annotations

import asyncio
import ssl
import threading
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from typing import Any

import structlog
from paho.mqtt.client import Client as Mqtt
from paho.mqtt.client import MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from rcp_gateway.api import PluginStore
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import ConfigError, RcpError
from rcp_vda5050.config import RobotConfig, VdaConfig
from rcp_vda5050.robot import LARGEST, Robot
from rcp_vda5050.zone_intake import Fetch
from rcp_vda5050.zone_store import load_rows

__all__ = ["open_robots"]

log = structlog.get_logger("rcp.vda5050")
_SOON, _LATE = 1, 10  # s until the broker is tried again, at first and at last
_KEEPALIVE = 10  # s
_FAREWELL = 2.0  # s for the last message to arrive
_QUEUED = 1000  # messages that wait for the event loop
_BYTES = 16 << 20  # of these together
_MORE = 1.25  # times as much for instant actions, which may be to stop
_TOPICS = {
    "2.1": ("order", "instantActions"),
    "3.0": ("order", "instantActions", "zoneSet", "responses"),
}
_AT_ONCE = frozenset({"order", "instantActions", "responses"})
"""Topics whose messages are carried out when they come: one that the broker has kept may be of yesterday."""


class Client:
    """One robot at the broker."""

    def __init__(
        self,
        config: VdaConfig,
        robot: RobotConfig,
        client_api: ClientApi,
        tls: ssl.SSLContext | None,
        store: PluginStore,
        fetch: Fetch | None,
    ) -> None:
        self._config, self._loop = config, client_api.loop
        major = robot.version[0]
        self._base = f"{config.interface}/v{major}/{robot.manufacturer}/{robot.serial}"
        self._topics = _TOPICS[robot.version]
        self._broken = "CONNECTIONBROKEN" if major == "2" else "CONNECTION_BROKEN"
        self.robot = Robot(robot, client_api, config.visualization, self._publish, store, fetch)
        self.online = False
        self._waiting = self._bytes = 0
        self._counting = threading.Lock()
        self._dropping: set[str] = set()
        """Topics of which messages were dropped since none waited, which the robot has been told."""
        self._mqtt = Mqtt(
            CallbackAPIVersion.VERSION2, client_id=f"rcp-{robot.manufacturer}-{robot.serial}"
        )
        if config.username is not None:
            self._mqtt.username_pw_set(config.username, config.password)
        if tls is not None:
            self._mqtt.tls_set_context(tls)
        self._mqtt.reconnect_delay_set(_SOON, _LATE)
        self._mqtt.on_connect = self._connected
        self._mqtt.on_connect_fail = lambda *_: self._soon(self._lost, "it cannot be reached")
        self._mqtt.on_disconnect = lambda _c, _u, _f, why, _p: self._soon(self._lost, str(why))
        self._mqtt.on_message = self._received

    async def open(self, rows: Mapping[str, Any]) -> None:
        """Begin to work, with the zones of earlier runs, and then to connect."""
        await self.robot.open(rows)
        self._renew_will()
        self._mqtt.connect_async(self._config.host, self._config.port, _KEEPALIVE)
        self._mqtt.loop_start()

    async def close(self) -> None:
        """Say so, and leave the broker."""
        await self.robot.close()
        farewell = self._say_connection("OFFLINE") if self.online else None
        self.online = False

        def leave() -> None:
            if farewell is not None:
                with suppress(RuntimeError, ValueError):  # the broker is gone
                    farewell.wait_for_publish(_FAREWELL)
            self._mqtt.disconnect()
            self._mqtt.loop_stop()
            if self._mqtt.socket() is not None:  # its thread was connecting again just then
                self._mqtt.disconnect()
            self._mqtt._reset_sockets()  # noqa: SLF001 - which paho leaves to the garbage collection

        await asyncio.to_thread(leave)

    # In the thread of the connection

    def _soon(self, function: Any, *arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, *arguments)

    def _connected(self, client: Mqtt, _userdata: Any, _flags: Any, why: Any, _more: Any) -> None:
        if why.is_failure:
            self._soon(self._lost, str(why))
            return
        client.subscribe([(self._topic(topic), 1) for topic in self._topics])
        self._soon(self._reached)

    def _received(self, _client: Mqtt, _userdata: Any, message: MQTTMessage) -> None:
        size, topic = len(message.payload), message.topic.rpartition("/")[2]
        take = partial(self.robot.take, topic, message.payload)
        if size > LARGEST:  # which need not wait itself to be refused
            take, size = partial(self.robot.refuse_large, topic, size), 0
        elif message.retain and topic in _AT_ONCE:
            take = partial(self.robot.take_kept, topic, message.payload)
        room = _MORE if topic == "instantActions" else 1.0
        with self._counting:
            full = self._waiting >= _QUEUED * room or self._bytes + size > _BYTES * room
            if not full:
                self._waiting, self._bytes = self._waiting + 1, self._bytes + size
            elif topic in self._dropping:
                return
            else:
                self._dropping.add(topic)
        if full:
            self._soon(self.robot.refuse_dropped, topic)
        else:
            self._soon(self._take, topic, size, take)

    # In the event loop

    def _reached(self) -> None:
        log.info("broker_reached", broker=self._config.broker, topic=self._base)
        self.online = True
        self._say_connection("ONLINE")
        self._renew_will()
        self.robot.greet()

    def _lost(self, why: str) -> None:
        self.online = False
        log.warning("broker_lost", broker=self._config.broker, topic=self._base, reason=why)

    def _take(self, topic: str, size: int, take: Callable[[], None]) -> None:
        with self._counting:
            self._waiting, self._bytes = self._waiting - 1, self._bytes - size
            if not self._waiting:
                self._dropping.clear()
        try:
            take()
        except Exception:  # of one message: the next one may be to cancel
            log.exception("message_failed", topic=f"{self._base}/{topic}")

    def _renew_will(self) -> None:
        """Leave the last will of the next connection."""
        payload = self.robot.connection(self._broken)
        self._mqtt.will_set(self._topic("connection"), payload, qos=1, retain=True)

    def _say_connection(self, how: str) -> Any:
        payload = self.robot.connection(how)
        return self._mqtt.publish(self._topic("connection"), payload, qos=1, retain=True)

    def _publish(self, topic: str, body: dict[str, Any]) -> None:
        """Send a message; without a broker nobody misses it, as a state is said anew."""
        if self.online:
            kept = topic == "factsheet"
            payload = self.robot.written(topic, body)
            self._mqtt.publish(self._topic(topic), payload, qos=int(kept), retain=kept)

    def _topic(self, name: str) -> str:
        return f"{self._base}/{name}"


def _tls(config: VdaConfig) -> ssl.SSLContext | None:
    if not config.secure:
        return None
    context = ssl.create_default_context(cafile=config.ca)
    if config.certificate is not None:
        context.load_cert_chain(config.certificate)
    return context


def _fetches(config: VdaConfig) -> dict[str, Fetch]:
    """Return what downloads zone sets, of the robots that may."""
    allowed = {name: one.downloads for name, one in config.robots.items() if one.downloads}
    if not allowed:
        return {}
    from rcp_vda5050.downloads import (
        Downloads,
    )  # which needs more memory than is worth it otherwise

    trusted = ssl.create_default_context()
    if config.ca is not None:
        trusted.load_verify_locations(config.ca)
    return {name: Downloads(origins, trusted).fetch for name, origins in allowed.items()}


@asynccontextmanager
async def open_robots(config: VdaConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Have the robots at the broker while entered; it may come and go.

    :raises ConfigError: a key is not known, or a certificate cannot be read.
    """
    try:
        tls = await asyncio.to_thread(_tls, config)
        fetches = await asyncio.to_thread(_fetches, config)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"plugins.vda5050: `ca` or `certificate`: {error}") from error
    store = client_api.store("zones")
    rows = await asyncio.to_thread(load_rows, store)
    async with AsyncExitStack() as stack:
        for name, one in config.robots.items():
            try:
                client = Client(config, one, client_api, tls, store, fetches.get(name))
            except RcpError as error:
                where = f"plugins.vda5050.robots.{name}"
                raise ConfigError(f"{where}: `token`: {error}") from error
            stack.push_async_callback(client.close)
            await client.open(rows)
        yield {"broker": config.broker}
