"""Bring a whole gateway up from a configuration, and down again in reverse."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import msgspec
import structlog

from rcp_kernel.access.identities import check_proofs, store_file
from rcp_kernel.config.file import BackendConfig, GatewayConfig, decode_table
from rcp_kernel.door import Door
from rcp_kernel.errors import ConfigError
from rcp_kernel.gateway import Gateway
from rcp_kernel.motion.insist import insist
from rcp_kernel.plugins import Missing, Plugins
from rcp_kernel.process.guard import GuardLink
from rcp_kernel.process.log import Recent
from rcp_kernel.process.supervisor import Slot
from rcp_kernel.record.store import DiskStore, Store
from rcp_kernel.spi import AdapterKind, TransportKind
from rcp_kernel.status import StatusReport, gateway_version
from rcp_kernel.system import System

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
_HALT_WAIT = 3.0  # s the robots have to come to rest before their backends are closed
_CLOSE_WAIT = 5.0  # s a backend has to close
_FIRST_OPEN = 1.0  # s that backends have from their start until clients are let in, ready or not


class Prepared(msgspec.Struct, frozen=True):
    """A configuration whose every table was decoded, and the plugins that it names."""

    config: GatewayConfig
    plugins: Plugins
    backends: tuple[Any, ...]
    """The plugin's own part of each `[[backends]]`, None where its plugin is missing."""
    transports: dict[str, Any]
    adapters: dict[str, Any]


class Reloading:
    """What reloads of one gateway share, so that they are applied in order."""

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        """Held while backends are closed and started."""
        self.newest: Prepared | None = None


class Server(msgspec.Struct, frozen=True):
    """A gateway that is up."""

    gateway: Gateway
    door: Door
    status: StatusReport
    slots: list[Slot]
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
        backends.append(decode_table(backend.options, kind.config, where))
    transports = _tables(config.transports, plugins.transports, f"{source}: [transports.")
    for name, table in transports.items():
        if (check := plugins.transports[name].check) is not None:
            try:
                check(table, config)
            except ConfigError as error:
                raise ConfigError(f"{source}: {error}") from None
    adapters = _tables(config.plugins, plugins.adapters, f"{source}: [plugins.")
    return Prepared(config, plugins, tuple(backends), transports, adapters)


def _tables(raw: dict[str, dict[str, Any]], kinds: dict[str, Any], where: str) -> dict[str, Any]:
    return {
        name: decode_table(table, kinds[name].config, f"{where}{name}]: ")
        for name, table in raw.items()
        if name in kinds
    }


@asynccontextmanager
async def running(prepared: Prepared, recent: Recent | None = None) -> AsyncGenerator[Server]:
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
            authenticator=plugins.authenticator,
            interceptors=plugins.interceptors,
        )
        slots: list[Slot] = []
        status = StatusReport(gateway, slots, recent)
        System(gateway, slots, status, recent)
        _keep_record(stack, gateway)
        stack.callback(setattr, recent, "told", None)
        status.start()
        stack.callback(status.stop)
        stack.push_async_callback(gateway.close)
        await stack.enter_async_context(gateway.identities.running())
        door = Door(gateway, status, "gateway")
        server = Server(gateway, door, status, slots, {})
        status.guard = GuardLink(gateway, slots)
        status.guard.start()
        stack.push_async_callback(status.guard.close)
        await stack.enter_async_context(_backends(server, prepared))
        first = loop.time() + _FIRST_OPEN
        await _open_all(stack, door, prepared.adapters, plugins.adapters, status.adapters)
        await _settled(slots, first - loop.time())
        await _open_all(stack, door, prepared.transports, plugins.transports, status.transports)
        _report_missing(plugins.missing, status)
        stack.push_async_callback(_rest, gateway, slots)
        yield server


def _keep_record(stack: AsyncExitStack, gateway: Gateway) -> None:
    audit = gateway.audit
    audit.start(name=gateway.config.name, version=gateway_version())
    for command in gateway.history.cut_off:
        gateway.recording.ended(command)
    gateway.keeping.start()
    gateway.returning.start()

    def stop() -> None:
        gateway.keeping.stop()
        gateway.returning.stop()
        audit.close()
        audit.note("stop", principal=None)

    stack.callback(stop)


async def _open_all(
    stack: AsyncExitStack,
    door: Door,
    tables: dict[str, Any],
    kinds: dict[str, TransportKind] | dict[str, AdapterKind],
    facts: list[dict[str, Any]],
) -> None:
    for name in sorted(tables, key=lambda n: getattr(kinds[n], "listens", False)):
        opened = await stack.enter_async_context(kinds[name].open(tables[name], door.renamed(name)))
        facts.append({"name": name, "state": "ready", **(opened or {})})


def _report_missing(missing: list[Missing], status: StatusReport) -> None:
    for one in missing:
        if one.group == "backends":
            continue
        facts = status.transports if one.group == "transports" else status.adapters
        facts.append({"name": one.name, "state": "down", "detail": f"{one.reason}; {one.remedy}"})
        log.warning("plugin_unavailable", plugin=one.name, reason=one.reason, remedy=one.remedy)


@asynccontextmanager
async def _backends(server: Server, prepared: Prepared) -> AsyncGenerator[None]:
    for backend, table in zip(prepared.config.backends, prepared.backends, strict=True):
        start_backend(server, prepared, backend, table)
    try:
        yield
    finally:
        await asyncio.gather(*(stop_backend(server, slot) for slot in list(server.slots)))


async def _settled(slots: Sequence[Slot], within: float) -> None:
    """Wait for backends that are quick to open, so that they are there for the first client."""
    waiters = [asyncio.ensure_future(slot.settled.wait()) for slot in slots]
    if waiters:
        _, late = await asyncio.wait(waiters, timeout=max(0.0, within))
        for waiter in late:
            waiter.cancel()


def start_backend(server: Server, prepared: Prepared, config: BackendConfig, table: Any) -> None:
    """Start the life of one backend."""
    slot = Slot(server.gateway, config)
    server.slots.append(slot)
    missing = prepared.plugins.is_missing("backends", config.use)
    if missing is not None:
        slot.fail("unavailable", f"{missing.reason}; try: {missing.remedy}")
        return
    kind = prepared.plugins.backends[config.use]
    name = f"backend {slot.name}"
    server.tasks[slot.name] = asyncio.create_task(slot.run(kind, table), name=name)


async def stop_backend(server: Server, slot: Slot) -> None:
    """Close one backend, within a bound, and take what it declared out of the tree."""
    slot.close()
    task = server.tasks.pop(slot.name, None)
    if task is not None:
        _, late = await asyncio.wait([task], timeout=_CLOSE_WAIT)
        if late:
            log.error("backend_does_not_close", backend=slot.name)
            task.cancel()
    for entry in slot.entries.values():
        server.gateway.deadman.begin(entry)  # there is nobody left to be told to stop
    slot.withdraw(*list(slot.entries))
    if slot in server.slots:
        server.slots.remove(slot)


async def _rest(gateway: Gateway, slots: list[Slot]) -> None:
    """Bring everything that moves to rest before anything closes."""
    gateway.closing = True
    _ground(gateway, slots)
    halts = _halts(slots)
    await gateway.commands.close()
    await _halted(halts)


def _ground(gateway: Gateway, slots: list[Slot]) -> None:
    for slot in slots:
        for entry in slot.entries.values():
            if entry.moves:
                gateway.deadman.ground(entry)


async def retire(server: Server, slots: list[Slot]) -> None:
    """Bring backends to rest that the gateway goes on without, then close them."""
    for slot in slots:
        slot.retire()
    _ground(server.gateway, slots)
    await _halted(_halts(slots))
    await asyncio.gather(*(stop_backend(server, slot) for slot in slots))


def _halts(slots: Sequence[Slot]) -> list[asyncio.Task[None]]:
    return [
        insist(slot.whole.halt, "halt_failed", backend=slot.name)
        for slot in slots
        if slot.backend is not None
    ]


async def _halted(halts: Sequence[asyncio.Future[None]]) -> None:
    if halts:
        _, late = await asyncio.wait(halts, timeout=_HALT_WAIT)
        for waiter in late:
            log.error("robot_not_at_rest", detail="a backend did not confirm its halt in time")
            waiter.cancel()
