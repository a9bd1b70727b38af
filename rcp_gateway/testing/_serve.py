"""A real gateway for a test: whole, around a robot of the author's, and without a socket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_gateway.client_kinds import AdapterKind, TransportKind
from rcp_gateway.features import active
from rcp_gateway.log import Recent
from rcp_gateway.plugins import Plugins
from rcp_gateway.server import Prepared, Server, running
from rcp_gateway.supervisor import BackendSupervisor
from rcp_gateway.testing._client import MemoryClient
from rcp_gateway.testing._clock import UnguardedLoop
from rcp_gateway.testing._recorder import Recorder
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import GatewayConfig, KeyConfig, decode_table, parse
from rcp_kernel.config.safety import Safety
from rcp_kernel.features import FeatureKind
from rcp_kernel.spi import Backend, BackendKind, Host
from rcp_kernel.values import Encoding

__all__ = ["ADMIN", "OPERATOR", "VIEWER", "Life", "Served", "loopback", "serve", "serve_backend"]

Open = Callable[[Any, Host], AbstractAsyncContextManager[Backend]]

OPERATOR = "operator-of-the-test-kit"
VIEWER = "viewer-of-the-test-kit"
ADMIN = "admin-of-the-test-kit"
"""API keys of the gateways that `serve_backend` runs, each with the role of its name."""

_KEYS = tuple(
    KeyConfig(name=role, role=role, key=key)
    for role, key in (("operator", OPERATOR), ("viewer", VIEWER), ("admin", ADMIN))
)
_GUARD_AFTER = 10.0  # s


class Life(msgspec.Struct, frozen=True):
    """One life of a backend, from its opening on; kept after it has closed."""

    kind: str
    backend: Backend
    host: Recorder


class Served:
    """A running gateway, and the backends opened in it."""

    def __init__(self, server: Server, lives: list[Life]) -> None:
        self.server = server
        self.lives = lives
        self._first = server.supervisors[0].config.use if server.supervisors else None

    @property
    def life(self) -> Life:
        """The latest life of the first backend, or of the one that opened first if it has none.

        Which one opens first says nothing: a device has to answer before its backend is open.
        """
        kinds = [self._first, self.lives[0].kind]
        name = next(kind for kind in kinds if any(life.kind == kind for life in self.lives))
        return next(life for life in reversed(self.lives) if life.kind == name)

    @property
    def supervisor(self) -> BackendSupervisor:
        """The supervisor's side of the first backend."""
        return self.server.supervisors[0]

    def client(self, token: str | None = None, encoding: Encoding = Encoding.JSON) -> MemoryClient:
        """Connect a client in memory; without a token it is anonymous."""
        return MemoryClient(self.server.client_api, token, encoding)


@asynccontextmanager
async def serve(
    config: str | GatewayConfig,
    *kinds: BackendKind,
    recent: Recent | None = None,
    features: Sequence[FeatureKind] = (),
    transports: Sequence[TransportKind] = (),
    adapters: Sequence[AdapterKind] = (),
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[Served]:
    """Run the gateway of a configuration while entered.

    Recent warnings appear in its status if `recent`, of `configure`, is given. The `kinds` serve its
    `[[backends]]` by name, without an entry point, and `features` are active besides those of the
    configuration; `transports` and `adapters` serve its tables by name. Transports in a `GatewayConfig`
    are opened; a text that names none opens none. With the default `guard_after`, the guard waits as
    long as possible: the test and its simulations share the gateway's event loop, and on an
    `UnguardedLoop` there is none. A test that steps time passes the `clock` of its `SteppedClock`,
    and runs on a `SteppedLoop`.

    :raises StartupError: as `rcpd serve` would.
    """
    if isinstance(config, str):
        config = parse(_QUIET + config, "test")
    config = _patient(config)
    if not structlog.is_configured():
        _log_plainly()
    lives: list[Life] = []
    given = {kind.name: _noted(kind, lives) for kind in kinds}
    own = {kind.name: kind for kind in features}
    others = {name: table for name, table in config.features.items() if name not in own}
    wires = {kind.name: kind for kind in transports}
    guests = {kind.name: kind for kind in adapters}
    installed = msgspec.structs.replace(
        config,
        backends=tuple(b for b in config.backends if b.use not in given),
        features=others,
        transports={n: table for n, table in config.transports.items() if n not in wires},
        plugins={n: table for n, table in config.plugins.items() if n not in guests},
    )
    plugins = Plugins(installed)
    plugins.backends.update(given)
    plugins.features.update(own)
    plugins.transports.update(wires)
    plugins.adapters.update(guests)
    config = msgspec.structs.replace(config, features=dict.fromkeys(own, True) | config.features)
    tables = [
        decode_table(b.options, plugins.backends[b.use].config, f"test: backend '{b.name}': ")
        for b in config.backends
    ]
    open_transports = {
        name: decode_table(table, plugins.transports[name].config, f"test: [transports.{name}]: ")
        for name, table in config.transports.items()
    }
    open_adapters = {
        name: decode_table(table, plugins.adapters[name].config, f"test: [plugins.{name}]: ")
        for name, table in config.plugins.items()
        if name in plugins.adapters
    }
    made = active(config, plugins.features, "test")
    prepared = Prepared(config, plugins, tuple(tables), open_transports, open_adapters, made)
    async with running(prepared, recent, clock=clock) as server:
        yield Served(server, lives)


def _patient(config: GatewayConfig) -> GatewayConfig:
    """Let the guard tolerate a busy machine, and keep out of a time that is not the machine's."""
    if config.safety.guard_after not in (Safety().guard_after, _GUARD_AFTER):
        return config
    guard = config.safety.guard and not isinstance(asyncio.get_running_loop(), UnguardedLoop)
    safety = msgspec.structs.replace(config.safety, guard=guard, guard_after=_GUARD_AFTER)
    return msgspec.structs.replace(config, safety=safety)


def _log_plainly() -> None:
    """Write tracebacks plainly: a pretty one holds the gateway up for most of a second."""
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.dev.ConsoleRenderer(
                colors=False, exception_formatter=structlog.dev.plain_traceback
            ),
        ]
    )


_QUIET = "[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"


@asynccontextmanager
async def serve_backend(
    backend: BackendKind | Open,
    options: Mapping[str, Any] | msgspec.Struct | None = None,
    *,
    tenant: str = "t",
    robot: str | None = None,
    beside: Sequence[BackendKind] = (),
    store: Path | None = None,
    guard_after: float = _GUARD_AFTER,
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[Served]:
    """Run a gateway around one backend: a kind with its table, or an `open` with its Struct.

    The kinds in `beside`, which have no options, serve the same robot. Clients use the keys `OPERATOR`,
    `VIEWER` and `ADMIN`. `guard_after` is as in `[safety]`, for tests that block the event loop.

    :raises ConfigError: the table does not fit the kind's type.
    """
    if not isinstance(backend, BackendKind):
        type_ = type(options) if isinstance(options, msgspec.Struct) else msgspec.Struct
        backend = BackendKind("backend", type_, backend)
    table = options if isinstance(options, Mapping) else msgspec.to_builtins(options or {})
    raw = {
        "backends": [
            {
                "use": backend.name,
                "name": backend.name,
                "tenant": tenant,
                "robot": robot,
                "options": dict(table),
            },
            *(
                {"use": kind.name, "name": kind.name, "tenant": tenant, "robot": robot}
                for kind in beside
            ),
        ],
        "store": {"path": None if store is None else str(store)},
        "safety": {"guard_after": guard_after},
    }
    config = decode_table(raw, GatewayConfig, "test: ")
    config = msgspec.structs.replace(config, keys=_KEYS)
    async with serve(config, backend, *beside, clock=clock) as served:
        yield served


@asynccontextmanager
async def loopback(
    source: str | GatewayConfig | BackendKind | Open,
    options: Mapping[str, Any] | msgspec.Struct | None = None,
    *,
    token: str | None = None,
    encoding: Encoding = Encoding.JSON,
) -> AsyncGenerator[MemoryClient]:
    """Run a gateway without sockets and yield a client of it.

    `source` is a configuration, or a backend as `serve_backend` takes it; a backend's client is
    an operator unless a token says otherwise.
    """
    if isinstance(source, (str, GatewayConfig)):
        async with serve(source) as served:
            yield served.client(token, encoding)
    else:
        async with serve_backend(source, options) as served:
            yield served.client(token or OPERATOR, encoding)


def _noted(kind: BackendKind, lives: list[Life]) -> BackendKind:
    """Return the kind, with each of its lives put on the list."""

    @asynccontextmanager
    async def open_noted(config: Any, host: Host) -> AsyncGenerator[Backend]:
        recorder = Recorder(host)
        async with kind.open(config, recorder) as backend:
            lives.append(Life(kind.name, backend, recorder))
            yield backend

    return msgspec.structs.replace(kind, open=open_noted)
