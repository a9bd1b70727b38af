"""Bring a whole gateway up from a configuration, and down again in reverse."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import msgspec
import structlog

from rcp_gateway.client_api import ClientApi
from rcp_gateway.client_kinds import AdapterKind, TransportKind
from rcp_gateway.features import ActiveFeature, active
from rcp_gateway.gateway import Gateway
from rcp_gateway.log import Recent
from rcp_gateway.plugins import Missing, Plugins
from rcp_gateway.status import StatusReport
from rcp_gateway.supervisor import BackendSupervisor
from rcp_kernel.access.identities import check_proofs, store_file
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import BackendConfig, GatewayConfig, decode_table
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.errors import ConfigError
from rcp_kernel.safety.retry import retry_until_confirmed
from rcp_store.disk_store import DiskStore
from rcp_store.store import Store

__all__ = [
    "Prepared",
    "Reloading",
    "Server",
    "prepare",
    "retire",
    "running",
    "start_backend",
    "stop_backend",
]

log = structlog.get_logger("rcp.server")
_HALT_WAIT = 3.0  # s for the robots to come to rest before their backends are closed
_CLOSE_WAIT = 5.0  # s a backend has to close
_FIRST_OPEN = 1.0  # s that backends have to open until clients are admitted, ready or not
_SHARE = 0.05  # s of that at a time


class Prepared(msgspec.Struct, frozen=True):
    """A decoded configuration, and the plugins that it names."""

    config: GatewayConfig
    plugins: Plugins
    backends: tuple[Any, ...]
    """The plugin's own part of each `[[backends]]`, None where its plugin is missing."""
    transports: dict[str, Any]
    adapters: dict[str, Any]
    features: tuple[ActiveFeature, ...] = ()


class Reloading:
    """The shared state of a gateway's reloads, which are applied in order."""

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        """Held while backends are closed and started."""
        self.newest: Prepared | None = None


class Server(msgspec.Struct, frozen=True):
    """A running gateway."""

    gateway: Gateway
    client_api: ClientApi
    status: StatusReport
    supervisors: list[BackendSupervisor]
    tasks: dict[str, asyncio.Task[None]]
    """Of the backends, by name."""
    reloading: Reloading = msgspec.field(default_factory=Reloading)


def prepare(config: GatewayConfig, source: str) -> Prepared:
    """Load the plugins and decode their tables; opens no robot and no socket.

    :raises ConfigError: a table does not fit its plugin's type, or names no plugin.
    :raises PluginError: a plugin breaks a rule.
    """
    check_proofs(config, source)
    plugins = Plugins(config)
    backends: list[Any] = []
    for backend in config.backends:
        kind = plugins.backends.get(backend.use)
        if kind is None:
            if plugins.is_missing("backends", backend.use) is None:
                raise ConfigError(f"{source}: no plugin offers the backend '{backend.use}'")
            backends.append(None)
            continue
        where = f"{source}: backend '{backend.name}' ({backend.use}): "
        table = decode_table(backend.options, kind.config, where)
        if kind.check is not None:
            try:
                kind.check(table)
            except ConfigError as error:
                raise ConfigError(f"{where}{error}") from None
        backends.append(table)
    transports = _tables(config.transports, plugins.transports, f"{source}: [transports.")
    _check_tables(transports, plugins.transports, config, source)
    adapters = _tables(config.plugins, plugins.adapters, f"{source}: [plugins.")
    _check_tables(adapters, plugins.adapters, config, source)
    features = active(config, plugins.features, source)
    return Prepared(config, plugins, tuple(backends), transports, adapters, features)


def _tables(raw: dict[str, dict[str, Any]], kinds: dict[str, Any], where: str) -> dict[str, Any]:
    return {
        name: decode_table(table, kinds[name].config, f"{where}{name}]: ")
        for name, table in raw.items()
        if name in kinds
    }


def _check_tables(
    tables: dict[str, Any],
    kinds: Mapping[str, TransportKind | AdapterKind],
    config: GatewayConfig,
    source: str,
) -> None:
    for name, table in tables.items():
        if (check := kinds[name].check) is not None:
            try:
                check(table, config)
            except ConfigError as error:
                raise ConfigError(f"{source}: {error}") from None


@asynccontextmanager
async def running(
    prepared: Prepared, recent: Recent | None = None, *, clock: Clock = SYSTEM_CLOCK
) -> AsyncGenerator[Server]:
    """Run a gateway while entered.

    :raises ConfigError: a transport or adapter cannot be opened as configured.
    """
    config, plugins = prepared.config, prepared.plugins
    recent = recent or Recent()
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack:
        store = Store()
        path = store_file(config)
        if path is not None:
            store = DiskStore(path, loop)
            stack.callback(store.close)
        gateway = Gateway(
            config,
            loop,
            store=store,
            recent=recent,
            clock=clock,
            features=prepared.features,
        )
        client_api, status = gateway.client_api, gateway.status
        server = Server(gateway, client_api, status, gateway.supervisors, {})
        _keep_record(stack, gateway)
        stack.callback(gateway.system.close)
        status.start()
        stack.callback(status.stop)
        stack.push_async_callback(gateway.close)
        await stack.enter_async_context(gateway.features.running())
        await stack.enter_async_context(_backends(server, prepared))
        settling = asyncio.create_task(_settled(gateway.supervisors, _FIRST_OPEN))
        stack.callback(settling.cancel)
        await _open_all(stack, client_api, prepared.adapters, plugins.adapters, status.adapters)
        _report_missing(plugins.missing, status)
        _report_unused(status, plugins.points["plugins"])
        await settling
        await _open_all(
            stack, client_api, prepared.transports, plugins.transports, status.transports
        )
        stack.push_async_callback(_rest, gateway)
        yield server


def _keep_record(stack: AsyncExitStack, gateway: Gateway) -> None:
    name = gateway.settings.config.name
    gateway.event_bus.note("start", principal=None, name=name, version=gateway_version())
    gateway.journal.tell_cut_off()
    gateway.resume.start()

    def stop() -> None:
        gateway.resume.stop()
        gateway.event_bus.note("stop", principal=None)

    stack.callback(stop)


async def _open_all(
    stack: AsyncExitStack,
    client_api: ClientApi,
    tables: dict[str, Any],
    kinds: dict[str, TransportKind] | dict[str, AdapterKind],
    facts: list[dict[str, Any]],
) -> None:
    for name in sorted(tables, key=lambda n: getattr(kinds[n], "listens", False)):
        if (lacking := _lacking(kinds[name], tables[name])) is not None:
            facts.append({"name": name, "state": "down", "detail": lacking})
            log.warning("plugin_unavailable", plugin=name, reason=lacking)
            continue
        opened = await stack.enter_async_context(
            kinds[name].open(tables[name], client_api.renamed(name))
        )
        facts.append({"name": name, "state": "ready", **(opened or {})})


def _lacking(kind: TransportKind | AdapterKind, table: Any) -> str | None:
    if isinstance(kind, TransportKind) or kind.lacks is None:
        return None
    return kind.lacks(table)


def _report_missing(missing: list[Missing], status: StatusReport) -> None:
    for one in missing:
        if one.group == "backends":
            continue
        facts = status.transports if one.group == "transports" else status.adapters
        facts.append({"name": one.name, "state": "down", "detail": f"{one.reason}; {one.remedy}"})
        log.warning("plugin_unavailable", plugin=one.name, reason=one.reason, remedy=one.remedy)


def _report_unused(status: StatusReport, points: Iterable[str]) -> None:
    """List the installed adapters that the configuration leaves out; they are not loaded."""
    used = {one["name"] for one in status.adapters}
    for name in sorted(set(points) - used):
        detail = f"not configured; to serve it, add [plugins.{name}] to the configuration"
        status.adapters.append({"name": name, "state": "off", "detail": detail})


@asynccontextmanager
async def _backends(server: Server, prepared: Prepared) -> AsyncGenerator[None]:
    for backend, table in zip(prepared.config.backends, prepared.backends, strict=True):
        start_backend(server, prepared, backend, table)
    try:
        yield
    finally:
        await asyncio.gather(
            *(stop_backend(server, supervisor) for supervisor in list(server.supervisors))
        )


async def _settled(supervisors: Sequence[BackendSupervisor], within: float) -> None:
    """Wait for backends that open quickly, so that the first client finds their resources.

    The time is given in shares: a machine that stands still meanwhile takes one of them, not all.
    """
    waiters = {asyncio.ensure_future(supervisor.settled.wait()) for supervisor in supervisors}
    for _ in range(round(within / _SHARE)):
        if not waiters:
            return
        _, waiters = await asyncio.wait(waiters, timeout=_SHARE)
    for late in waiters:
        late.cancel()


def start_backend(server: Server, prepared: Prepared, config: BackendConfig, table: Any) -> None:
    """Start the life of one backend."""
    supervisor = server.gateway.supervise(config)
    server.supervisors.append(supervisor)
    missing = prepared.plugins.is_missing("backends", config.use)
    if missing is not None:
        supervisor.fail("unavailable", f"{missing.reason}; try: {missing.remedy}")
        return
    kind = prepared.plugins.backends[config.use]
    name = f"backend {supervisor.name}"
    server.tasks[supervisor.name] = asyncio.create_task(supervisor.run(kind, table), name=name)


async def stop_backend(server: Server, supervisor: BackendSupervisor) -> None:
    """Close one backend, within a bound, and remove its resources from the tree."""
    supervisor.close()
    task = server.tasks.pop(supervisor.name, None)
    if task is not None:
        _, late = await asyncio.wait([task], timeout=_CLOSE_WAIT)
        if late:
            log.error("backend_does_not_close", backend=supervisor.name)
            task.cancel()
    for entry in supervisor.entries.values():
        server.gateway.deadman.begin(entry)  # nothing could stop the actuator later
    supervisor.withdraw(*list(supervisor.entries))
    if supervisor in server.supervisors:
        server.supervisors.remove(supervisor)


async def _rest(gateway: Gateway) -> None:
    """Bring all robots without gateways of their own to rest, before anything closes."""
    gateway.shutdown.begin()
    ours = [one for one in gateway.supervisors if not one.has_gateways]
    _cancel_motion_writes(gateway, ours)
    halts = _halts(ours)
    await gateway.commands.close()
    await _halted(halts)


def _cancel_motion_writes(gateway: Gateway, supervisors: list[BackendSupervisor]) -> None:
    for supervisor in supervisors:
        for entry in supervisor.entries.values():
            if entry.moves:
                gateway.deadman.cancel_writes(entry)


async def retire(server: Server, supervisors: list[BackendSupervisor]) -> None:
    """Bring removed backends to rest, then close them."""
    for supervisor in supervisors:
        supervisor.retire()
    ours = [one for one in supervisors if not one.has_gateways]
    _cancel_motion_writes(server.gateway, ours)
    await _halted(_halts(ours))
    await asyncio.gather(*(stop_backend(server, supervisor) for supervisor in supervisors))


def _halts(supervisors: Sequence[BackendSupervisor]) -> list[asyncio.Task[None]]:
    return [
        retry_until_confirmed(supervisor.whole.halt, "halt_failed", backend=supervisor.name)
        for supervisor in supervisors
        if supervisor.backend is not None
    ]


async def _halted(halts: Sequence[asyncio.Future[None]]) -> None:
    if halts:
        _, late = await asyncio.wait(halts, timeout=_HALT_WAIT)
        for waiter in late:
            log.error("robot_not_at_rest", detail="a backend did not confirm its halt in time")
            waiter.cancel()
