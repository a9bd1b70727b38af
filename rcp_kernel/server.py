"""Bring a whole gateway up from a configuration, and down again in reverse."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import structlog

from rcp_kernel.config import GatewayConfig, decode_table
from rcp_kernel.door import Door
from rcp_kernel.errors import ConfigError
from rcp_kernel.gateway import Gateway
from rcp_kernel.log import Recent
from rcp_kernel.plugins import Missing, Plugins
from rcp_kernel.safety import halt
from rcp_kernel.spi import AdapterKind, TransportKind
from rcp_kernel.status import StatusReport
from rcp_kernel.store import Store
from rcp_kernel.supervisor import Slot
from rcp_kernel.system import System

__all__ = ["Prepared", "Server", "prepare", "running"]

log = structlog.get_logger("rcp.server")
_HALT_WAIT = 3.0  # s the robots have to come to rest before their backends are closed
_CLOSE_WAIT = 5.0  # s a backend has to close
_FIRST_OPEN = 1.0  # s the start-up waits for backends, so that a quick one is there at once


class Prepared(msgspec.Struct, frozen=True):
    """A configuration whose every table was decoded, and the plugins that it names."""

    config: GatewayConfig
    plugins: Plugins
    backends: tuple[Any, ...]
    """The plugin's own part of each `[[backends]]`, None where its plugin is missing."""
    transports: dict[str, Any]
    adapters: dict[str, Any]


class Server(msgspec.Struct, frozen=True):
    """A gateway that is up."""

    gateway: Gateway
    door: Door
    status: StatusReport
    slots: list[Slot]


def prepare(config: GatewayConfig, source: str) -> Prepared:
    """Load the plugins and decode their tables; opens no robot and no socket.

    :raises ConfigError: a table does not fit its plugin's type, or names no plugin.
    :raises PluginError: a plugin breaks a rule.
    """
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
    adapters = _tables(config.plugins, plugins.adapters, f"{source}: [plugins.")
    return Prepared(config, plugins, tuple(backends), transports, adapters)


def _tables(raw: dict[str, dict[str, Any]], kinds: dict[str, Any], where: str) -> dict[str, Any]:
    return {
        name: decode_table(table, kinds[name].config, f"{where}{name}]: ")
        for name, table in raw.items()
        if name in kinds
    }


@asynccontextmanager
async def running(prepared: Prepared, recent: Recent | None = None) -> AsyncIterator[Server]:
    """Run a gateway while entered.

    :raises ConfigError: a transport or adapter cannot be opened as configured.
    """
    config, plugins = prepared.config, prepared.plugins
    recent = recent or Recent()
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack:
        keeper = None
        if config.store.path is not None:
            keeper = Store(Path(config.store.path).expanduser())
            stack.callback(keeper.close)
        gateway = Gateway(
            config,
            loop,
            keeper=keeper,
            authenticator=plugins.authenticator,
            interceptors=plugins.interceptors,
        )
        if keeper is not None:
            gateway.commands.remember(keeper.load())
        slots = [Slot(gateway, backend) for backend in config.backends]
        status = StatusReport(gateway, slots, recent)
        System(gateway, slots, status, recent)
        stack.callback(setattr, recent, "told", None)
        status.start()
        stack.callback(status.stop)
        stack.push_async_callback(gateway.close)
        await stack.enter_async_context(_backends(prepared, slots))
        door = Door(gateway, status, "gateway")
        await _open_all(stack, door, prepared.adapters, plugins.adapters, status.adapters)
        await _open_all(stack, door, prepared.transports, plugins.transports, status.transports)
        _report_missing(plugins.missing, status)
        stack.push_async_callback(_rest, gateway, slots)
        yield Server(gateway, door, status, slots)


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
async def _backends(prepared: Prepared, slots: list[Slot]) -> AsyncIterator[None]:
    tasks: list[asyncio.Task[None]] = []
    for slot, table in zip(slots, prepared.backends, strict=True):
        missing = prepared.plugins.is_missing("backends", slot.config.use)
        if missing is not None:
            slot.fail("unavailable", f"{missing.reason}; try: {missing.remedy}")
            continue
        kind = prepared.plugins.backends[slot.config.use]
        tasks.append(asyncio.create_task(slot.run(kind, table), name=f"backend {slot.name}"))
    try:
        settled = [asyncio.ensure_future(slot.settled.wait()) for slot in slots]
        if settled:
            _, late = await asyncio.wait(settled, timeout=_FIRST_OPEN)
            for waiter in late:
                waiter.cancel()
        yield
    finally:
        for slot in slots:
            slot.close()
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=_CLOSE_WAIT)
            for task in late:
                log.error("backend_does_not_close", task=task.get_name())
                task.cancel()


async def _rest(gateway: Gateway, slots: list[Slot]) -> None:
    """Bring everything that moves to rest before anything closes."""
    gateway.closing = True
    halts = [asyncio.ensure_future(halt(slot)) for slot in slots if slot.backend is not None]
    await gateway.commands.close()
    if halts:
        _, late = await asyncio.wait(halts, timeout=_HALT_WAIT)
        for waiter in late:
            log.error("robot_not_at_rest", detail="a backend did not confirm its halt in time")
            waiter.cancel()
