"""Application of a new configuration to a running gateway, as far as it can change at run time."""

from __future__ import annotations

import msgspec
import structlog

from rcp_gateway.server import Prepared, Server, prepare, retire, start_backend
from rcp_kernel.config.file import GatewayConfig

__all__ = ["apply", "needs_restart", "prepare_reload"]

log = structlog.get_logger("rcp.reload")
_FIXED = ("transports", "plugins", "store", "log", "name")
"""Tables that cannot change at run time."""
_GUARD = ("guard", "guard_after", "guard_bound")
"""Keys of `[safety]` that cannot change while a guard runs."""


def needs_restart(running: GatewayConfig, fresh: GatewayConfig) -> list[str]:
    """Return the parts of a configuration that a reload would leave as they are."""
    changed = [part for part in _FIXED if getattr(running, part) != getattr(fresh, part)]
    if set(running.active_features) != set(fresh.active_features):
        changed.append("features")
    guard = (key for key in _GUARD if getattr(running.safety, key) != getattr(fresh.safety, key))
    return [*changed, *(f"safety.{key}" for key in guard)]


def prepare_reload(running: GatewayConfig, fresh: GatewayConfig, source: str) -> Prepared:
    """Prepare what a reload can change; the rest stays.

    Its rules must be safe with its own listeners, and with those that continue unchanged.

    :raises StartupError: it is invalid.
    """
    prepared = prepare(fresh, source)
    kept = {
        part: getattr(running, part)
        for part in _FIXED
        if getattr(running, part) != getattr(fresh, part)
    }
    if set(running.active_features) != set(fresh.active_features):
        kept["features"] = running.features
    if not kept:
        return prepared
    return prepare(msgspec.structs.replace(fresh, **kept), source)


async def apply(server: Server, prepared: Prepared) -> None:
    """Apply the rules, keys, limits and backends of a configuration to a running gateway.

    Rights change at once. Backends change one reload after the other: a backend that takes long to
    close must not delay the revocation of a key, and reloads must not be applied out of order.
    """
    gateway, turn = server.gateway, server.reloading
    turn.newest = prepared
    gateway.reconfigure(prepared.config, prepared.features)
    async with turn.lock:
        if turn.newest is not prepared:
            gateway.event_bus.note("reload", principal=None, outcome="superseded")
            return
        new = prepared.config
        gone = [
            supervisor for supervisor in server.supervisors if supervisor.config not in new.backends
        ]
        await retire(server, gone)
        if turn.newest is not prepared or gateway.shutdown.begun:
            gateway.event_bus.note("reload", principal=None, outcome="superseded")
            return
        kept = {supervisor.config.name for supervisor in server.supervisors}
        for backend, table in zip(new.backends, prepared.backends, strict=True):
            if backend.name not in kept:
                start_backend(server, prepared, backend, table)
    gateway.event_bus.note(
        "reload", principal=None, backends=[supervisor.name for supervisor in server.supervisors]
    )
    log.info(
        "reloaded",
        backends=len(server.supervisors),
        stopped=[supervisor.name for supervisor in gone],
    )
