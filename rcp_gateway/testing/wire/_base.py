"""The base of the wire tests: a gateway with robots, and clients over one transport."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import msgspec
import pytest

from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.server import Server
from rcp_gateway.testing._client import Client
from rcp_gateway.testing._serve import ADMIN, OPERATOR, VIEWER, Served, serve
from rcp_gateway.testing._suite import Suite, eventually
from rcp_gateway.testing.wire._requirements import REQUIREMENTS
from rcp_gateway.testing.wire._robot import DEAD, ROBOT, Absence, WireRobot
from rcp_kernel.config.file import GatewayConfig, StoreConfig, parse
from rcp_kernel.values import Encoding

__all__ = ["ASKING", "LOCAL", "Wire", "World", "configuration"]

ASKING = "asking-of-the-test-kit"
"""API key of a principal that needs approval for `service/nothing`."""
LOCAL = "local-of-the-test-kit"
"""API key of an operator of one tenant, who may not see `sensor/secret`."""

ARRIVAL = 30.0  # s within which a backend that waits between two attempts has come up

_CONFIG = f"""
[[backends]]
use = "wire-robot"
name = "main"
tenant = "alpha"

[[backends]]
use = "wire-robot"
name = "drone"
tenant = "alpha"
robot = "drone1"
small = true

[[backends]]
use = "dead-robot"
name = "ghost"
tenant = "alpha"
robot = "ghost"

[[backends]]
use = "wire-robot"
name = "other"
tenant = "beta"
small = true

[roles.blinkered]
deny = [{{ operations = ["discover"], paths = ["/sensor/secret", "/sensor/ghost/secret"] }}]

[roles.careful]
approve = ["/service/nothing"]

[[keys]]
name = "asking"
role = ["operator", "careful"]
tenants = ["alpha"]
key = "{ASKING}"

[[keys]]
name = "operator"
role = "operator"
key = "{OPERATOR}"

[[keys]]
name = "viewer"
role = "viewer"
key = "{VIEWER}"

[[keys]]
name = "admin"
role = "admin"
key = "{ADMIN}"

[[keys]]
name = "local"
role = ["operator", "blinkered"]
tenants = ["alpha"]
key = "{LOCAL}"

[limits]
message = 262144
subscriptions = 40
batch = 64
deadline = 2.0
in_flight = 2000
session_ttl = 2.5
"""


def configuration(transports: dict[str, dict[str, Any]]) -> GatewayConfig:
    """Return the gateway's configuration, with some transports open."""
    off = [f"{name} = false" for name in ("asgi", "http", "ws", "sse") if name not in transports]
    tables = "".join(
        f"[transports.{name}]\n" + "".join(f"{k} = {_toml(v)}\n" for k, v in table.items())
        for name, table in transports.items()
    )
    return parse("[transports]\n" + "\n".join(off) + "\n" + tables + _CONFIG, "test")


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')


class World:
    """A gateway with its robots, and clients that are closed at the end."""

    def __init__(self, served: Served, suite: Wire) -> None:
        self._served = served
        self._suite = suite
        self._clients: list[Client] = []

    @property
    def server(self) -> Server:
        """The gateway."""
        return self._served.server

    def robot(self, name: str = "main") -> WireRobot:
        """Return one of the robots by the name of its backend."""
        supervisor = next(
            supervisor for supervisor in self.server.supervisors if supervisor.name == name
        )
        found = getattr(supervisor.backend, "inner", None)
        assert isinstance(found, WireRobot)
        return found

    def publish(self, name: str, *values: Any) -> None:
        """Publish values of the main robot."""
        for value in values:
            self.robot().host.publish(name, value)

    async def arrive(self) -> None:
        """Bring up the missing robot; return once it is available."""
        Absence.ends = True
        supervisor = next(
            supervisor for supervisor in self.server.supervisors if supervisor.name == "ghost"
        )

        async def is_ready() -> bool:
            return supervisor.state == "ready"

        await eventually(is_ready, "the robot comes", ARRIVAL)

    def limit(self, **limits: float) -> None:
        """Change limits of the gateway while it runs, as a reload of its configuration does."""
        config = self.server.gateway.settings.config
        changed = msgspec.structs.replace(config.limits, **limits)
        self.server.gateway.reconfigure(msgspec.structs.replace(config, limits=changed))

    async def client(
        self, token: str | None = OPERATOR, encoding: Encoding = Encoding.JSON
    ) -> Client:
        """Connect a client over the transport under test."""
        client = await self._suite.connect(self.server, token, encoding)
        self._clients.append(client)
        return client

    async def close(self) -> None:
        """Cut every connection."""
        for client in self._clients:
            await client.close()


class Wire(Suite):
    """Base of the parts of the wire suite: what the author provides, and the shared gateway."""

    offers: ClassVar[frozenset[str]] = frozenset({"stream", "connection", "session"})
    """What the transport carries: `stream` for subscriptions and feedback, `connection` for many
    requests in flight on one, `session` for `hello` and resume."""
    encodings: ClassVar[tuple[Encoding, ...]] = tuple(Encoding)
    """The encodings that it carries."""
    transports: ClassVar[dict[str, dict[str, Any]]] = {}
    """The tables of `[transports]` that have to be open."""
    kinds: ClassVar[tuple[TransportKind, ...]] = ()
    """Transports of these tables that are not installed."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if cls.connect is Wire.connect:
            return  # a theme, not yet over a transport
        for name in dir(cls):
            ids: tuple[str, ...] = getattr(getattr(cls, name), "proves", ())
            if any(not REQUIREMENTS[id_].needs <= cls.offers for id_ in ids):
                setattr(cls, name, None)  # the requirement does not apply: not collected

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        """Connect a client to a running gateway, through the transport under test."""
        raise NotImplementedError

    @pytest.fixture
    async def world(self) -> AsyncGenerator[World]:
        """A gateway with robots, for one test."""
        Absence.ends = False
        with TemporaryDirectory() as folder:
            store = StoreConfig(path=f"{folder}/store.db")
            config = msgspec.structs.replace(configuration(self.transports), store=store)
            async with serve(config, ROBOT, DEAD, transports=self.kinds) as served:
                world = World(served, self)
                try:
                    yield world
                finally:
                    await world.close()
