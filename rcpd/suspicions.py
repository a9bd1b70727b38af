"""What fits, but is probably not meant, or cannot work for everybody who may run the gateway."""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rcp_kernel.access.identities import store_file
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import instant
from rcp_protocol.plain import is_list, is_map
from rcp_toml.positions import Place
from rcpd.words import nearest

__all__ = ["misplaced_store", "suspicions"]

_UNPRIVILEGED = Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")
_IN_TENANT = re.compile(r"/tenant/([\w.-]+)(?=/|\Z)")
_DEFAULT_UNPRIVILEGED = 1024


def suspicions(
    config: GatewayConfig, raw: Mapping[str, Any], files: Mapping[Place, Path]
) -> Iterator[tuple[Place, str]]:
    """Yield places of a file and what is suspicious there; `files` are those that contain secrets."""
    for place, tenant in _tenants_in(raw, ()):
        if tenant not in config.tenant_names:
            near = nearest(tenant, config.tenant_names)
            advice = f"did you mean '{near}'?" if near else "name one of a [[backends]]"
            yield place, f"this file has no tenant '{tenant}'; {advice}"
    yield from _low_port(config.transports.get("asgi", {}))
    yield from _unwritable_store(config)
    for place, path in files.items():
        mode = 0
        with suppress(OSError):  # one that cannot be read is a fault
            mode = path.stat().st_mode
        if mode & stat.S_IROTH:
            text = f"every user of this machine can read '{path}': run `chmod 600 {path}`"
            yield place, text
    for index, key in enumerate(config.keys):
        if key.expires is not None and instant(key.expires) < time.time_ns():
            text = (
                "is in the past, so the key authenticates nobody: remove it, or write a later day"
            )
            yield ("keys", index, "expires"), text


def _tenants_in(node: Any, place: Place) -> Iterator[tuple[Place, str]]:
    """Yield the tenants that paths in strings name, each with its place."""
    if is_map(node):
        for key, item in node.items():
            yield from _tenants_in(item, (*place, key))
    elif is_list(node):
        for index, item in enumerate(node):
            yield from _tenants_in(item, (*place, index))
    elif isinstance(node, str) and (found := _IN_TENANT.match(node)) is not None:
        yield place, found[1]


def _low_port(table: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    first = _DEFAULT_UNPRIVILEGED
    with suppress(OSError, ValueError):
        first = int(_UNPRIVILEGED.read_text(encoding="ascii"))
    port = table.get("port")
    if isinstance(port, int) and 0 < port < first:
        text = (
            f"only root may listen on a port below {first}: add "
            "`AmbientCapabilities=CAP_NET_BIND_SERVICE` to the unit, or put a proxy in front of "
            "another port"
        )
        yield ("transports", "asgi", "port"), text


def misplaced_store(config: GatewayConfig) -> str | None:
    """Return why there can be no store at its path, whoever runs the gateway."""
    path = store_file(config)
    if path is None:
        return None
    if path.is_dir():
        return f"'{path}' is a folder: name a file in it, such as '{path / 'rcp.db'}'"
    above = _existing(path)
    return None if above.is_dir() else f"'{above}' is a file, so the store cannot be below it"


def _existing(path: Path) -> Path:
    """Return the nearest folder or file above a path that is there."""
    return next(one for one in path.absolute().parents if one.exists())


def _unwritable_store(config: GatewayConfig) -> Iterator[tuple[Place, str]]:
    path = store_file(config)
    if path is None:
        return
    target = path if path.exists() else _existing(path)
    if not os.access(target, os.W_OK):
        text = (
            f"'{target}' cannot be written by the user of this command: make sure that the "
            "gateway's user can, or `rcpd serve` does not start"
        )
        yield ("store", "path"), text
