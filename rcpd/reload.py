"""Reloading the configuration file, on SIGHUP and when a proposed one is tried."""

from __future__ import annotations

from pathlib import Path

import structlog

from rcp_gateway.reload import apply, needs_restart, prepare_reload
from rcp_gateway.server import Server
from rcp_kernel.config.file import load
from rcp_kernel.errors import StartupError
from rcpd.diagnosis import explained
from rcpd.key_strength import log_weak_keys

__all__ = ["reload"]

log = structlog.get_logger("rcp.reload")


async def reload(server: Server, path: Path) -> bool:
    """Apply a configuration file; an invalid one changes nothing, is logged, and returns false."""
    running = server.gateway.settings.config
    try:
        fresh = load(path)
        prepared = prepare_reload(running, fresh, str(path))
    except StartupError as error:
        log.error("reload_refused", reason=explained(error, path))
        server.gateway.event_bus.note("reload", principal=None, outcome="refused")
        return False
    except Exception:
        log.exception("reload_failed", reason="a plugin or the gateway has a bug")
        server.gateway.event_bus.note("reload", principal=None, outcome="failed")
        return False
    log_weak_keys(fresh.keys, str(path))
    for part in needs_restart(running, fresh):
        log.warning("reload_needs_restart", part=part)
    await apply(server, prepared)
    return True
