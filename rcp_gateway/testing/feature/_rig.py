"""What the author of a feature provides to its suite, and the robot behind its guard."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, ClassVar

import msgspec
import pytest

from rcp_gateway.features import ActiveFeature, active
from rcp_gateway.testing._client import MemoryClient, Message
from rcp_gateway.testing._serve import ADMIN, OPERATOR, VIEWER, Served, serve
from rcp_gateway.testing._suite import Suite
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_kernel.features import FeatureKind
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress
from rcp_kernel.types import quantity

__all__ = ["FeatureGateway", "FeatureRig"]

_CONFIG = f"""
[transports]
asgi = false
http = false
ws = false
sse = false

[[backends]]
use = "robot"
name = "robot"
tenant = "t"

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
"""
_Speed = quantity("m/s", ge=-1, le=1)


class _NoOptions(msgspec.Struct):
    """The robot has nothing to configure."""


class GuardedRobot(BaseBackend):
    """Records what reaches it; its action ends on request."""

    def __init__(self, host: Host) -> None:
        self.speed = 0.0
        self.reached: list[tuple[str, Any]] = []
        self.release = asyncio.Event()
        host.declare(
            Resource(name="param/limit", description="A limit.", value=_Speed),
            Resource(
                name="actuator/drive", description="A drive.", value=_Speed, safe=0.0, valid_for=60
            ),
            Resource(name="action/go", description="Goes.", input=_Speed, policy="queue"),
        )

    async def write(self, name: str, value: Any) -> None:
        """Record the value."""
        self.reached.append((name, value))
        if name == "actuator/drive":
            self.speed = value

    async def execute(self, name: str, value: Any, progress: Progress) -> None:
        """Go until released."""
        self.reached.append((name, value))
        await self.release.wait()

    async def halt(self) -> None:
        """Stand still."""
        self.speed = 0.0

    def motion(self, robot: str | None) -> MotionState:
        """Measure."""
        return MotionState(at_rest=self.speed == 0)


class FeatureGateway:
    """A gateway with the feature, a robot, and a client of each role."""

    def __init__(self, served: Served, config: GatewayConfig) -> None:
        self.served = served
        self.config = config
        self.operator = served.client(OPERATOR)
        self.viewer = served.client(VIEWER)
        self.admin = served.client(ADMIN)

    @property
    def robot(self) -> GuardedRobot:
        """The robot, which records what has reached it."""
        backend = self.served.life.backend
        assert isinstance(backend, GuardedRobot)
        return backend

    def client(self, token: str) -> MemoryClient:
        """Connect a client with a key of `FeatureRig.more`."""
        return self.served.client(token)


class FeatureRig(Suite):
    """What only the author of a feature can provide."""

    kind: ClassVar[FeatureKind]
    """The feature under test."""
    options: ClassVar[Mapping[str, Any]] = {}
    """Its table `[features.<name>]`."""
    more: ClassVar[str] = ""
    """Added to the configuration, as TOML: roles, keys, tables that the feature reads."""
    refusal: ClassVar[str | None] = None
    """The error code by which its guard refuses; None: it has no guard."""

    async def engage(self, gateway: FeatureGateway) -> None:
        """Bring about that the guard refuses every command of the key `OPERATOR`."""
        raise NotImplementedError

    async def release(self, gateway: FeatureGateway) -> None:
        """Make the guard let commands pass again."""
        raise NotImplementedError

    def features(self, config: GatewayConfig, options: Any = None) -> tuple[ActiveFeature, ...]:
        """Decode the table of the feature, or other `options`, as a reload does.

        :raises ConfigError: the table does not fit.
        """
        raw = self.options if options is None else options
        table = True if self.kind.table is not None else dict(raw)
        own = msgspec.structs.replace(config, features={self.kind.name: table})
        return tuple(
            one for one in active(own, {self.kind.name: self.kind}, "test") if one.kind is self.kind
        )

    def opened(self) -> AbstractAsyncContextManager[FeatureGateway]:
        """Run a gateway with the feature."""
        return self._opened()

    @asynccontextmanager
    async def _opened(self) -> AsyncGenerator[FeatureGateway]:
        config = parse(_CONFIG + self.more, "test")
        if self.kind.table is None:
            table = {self.kind.name: dict(self.options)}
            config = msgspec.structs.replace(config, features=table)

        @asynccontextmanager
        async def open_robot(_config: _NoOptions, host: Host) -> AsyncGenerator[GuardedRobot]:
            yield GuardedRobot(host)

        kind = BackendKind("robot", _NoOptions, open_robot)
        async with serve(config, kind, features=(self.kind,)) as served:
            yield FeatureGateway(served, config)

    @pytest.fixture
    async def gateway(self) -> AsyncGenerator[FeatureGateway]:
        """A gateway with the feature, for one test."""
        async with self.opened() as opened:
            yield opened

    @pytest.fixture
    def guarded(self, gateway: FeatureGateway) -> FeatureGateway:
        """The gateway, for tests of its guard; skips where the feature has none."""
        if self.refusal is None:
            pytest.skip("the feature has no guard")
        return gateway


def error_code(reply: Message) -> str | None:
    """Return the error code of a refusal, None for success."""
    return reply.get("error", {}).get("code")
