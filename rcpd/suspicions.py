"""What fits, but is probably not meant, or cannot work for everybody who may run the gateway."""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rcp_kernel.access.identities import store_file
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import KeyConfig, instant
from rcp_protocol.plain import is_list, is_map
from rcp_protocol.similarity import closest
from rcp_toml.positions import Place
from rcp_toml.variables import NamedFile, Secret
from rcpd.survey import Survey

__all__ = ["misplaced_store", "suspicions"]

_UNPRIVILEGED = Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")
_IN_TENANT = re.compile(r"/tenant/([\w.-]+)(?=/|\Z)")
_DEFAULT_UNPRIVILEGED = 1024


def suspicions(survey: Survey) -> Iterator[tuple[Place, str]]:
    """Yield places of a file and what is suspicious there."""
    config = survey.config
    for found in (
        _unknown_tenants(survey),
        _low_port(config.transports.get("asgi", {})),
        _unwritable_store(config),
        _open_files(survey.secret_files),
        _expired(config.keys),
    ):
        with suppress(Exception):  # no doubt may hide the faults, whatever the file contains
            yield from found


def _unknown_tenants(survey: Survey) -> Iterator[tuple[Place, str]]:
    known = survey.config.tenant_names
    plain = [one for one in known if not isinstance(one, Secret)]
    for place, tenant in _tenants_in(survey.raw, ()):
        if tenant in known:
            continue
        near = closest(tenant, plain)
        if near is None and survey.is_included(place):
            continue  # several gateways may share the file, and another one has the tenant
        advice = f"did you mean '{near}'?" if near else "name one of a [[backends]]"
        yield place, f"this file has no tenant '{tenant}'; {advice}"


def _tenants_in(node: Any, place: Place) -> Iterator[tuple[Place, str]]:
    """Yield the tenants that paths in plain strings name, each with its place."""
    if is_map(node):
        for key, item in node.items():
            yield from _tenants_in(item, (*place, key))
    elif is_list(node):
        for index, item in enumerate(node):
            yield from _tenants_in(item, (*place, index))
    elif isinstance(node, str) and not isinstance(node, Secret):
        found = _IN_TENANT.match(node)
        if found is not None:
            yield place, found[1]


def _low_port(table: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    if os.geteuid() == 0:
        return
    first = _DEFAULT_UNPRIVILEGED
    with suppress(OSError, ValueError):
        first = int(_UNPRIVILEGED.read_text(encoding="ascii"))
    port = table.get("port")
    if isinstance(port, int) and not isinstance(port, bool) and 0 < port < first:
        text = (
            f"only root may listen on a port below {first}: add "
            "`AmbientCapabilities=CAP_NET_BIND_SERVICE` to the unit, or put a proxy in front of "
            "another port"
        )
        yield ("transports", "asgi", "port"), text


def _open_files(files: Iterable[tuple[Place, NamedFile]]) -> Iterator[tuple[Place, str]]:
    for place, file in files:
        open_ = False
        with suppress(OSError, ValueError):  # one that cannot be read is a fault
            open_ = _is_open(file.path)
        if open_:
            text = (
                f"every user of this machine can read '{file.name}': run `chmod o-r` on it, and "
                "make sure that the gateway's user can still read it"
            )
            yield place, text


def _is_open(path: Path) -> bool:
    """Return whether every user can read a file, of which somebody could change that."""
    # Of a path through links, it is the folders of the file itself that keep others out.
    real = Path(os.path.realpath(path))
    if not real.stat().st_mode & stat.S_IROTH:
        return False
    if os.statvfs(real).f_flag & os.ST_RDONLY:  # a secret that a container was given
        return False
    return all(above.stat().st_mode & stat.S_IXOTH for above in real.parents)


def _expired(keys: Iterable[KeyConfig]) -> Iterator[tuple[Place, str]]:
    for index, key in enumerate(keys):
        end = None
        with suppress(ValueError):  # one that is no day is a fault
            end = None if key.expires is None else instant(key.expires)
        if end is not None and end < time.time_ns():
            text = (
                "is in the past, so the key authenticates nobody: remove it, or write a later day"
            )
            yield ("keys", index, "expires"), text


def misplaced_store(config: GatewayConfig) -> str | None:
    """Return why there can be no store at its path, whoever runs the gateway."""
    path = store_file(config)
    if path is None:
        return None
    if "\0" in str(path):
        return "contains a NUL character, which no path can: take it out"
    if _is_folder(path):
        return f"'{path}' is a folder: name a file in it, such as '{path / 'rcp.db'}'"
    above = _existing(path)
    if above is None or _is_folder(above):
        return None
    return f"'{above}' is a file, so the store cannot be below it"


def _mode(path: Path) -> int | None:
    """Return the mode of a file or folder; None if it is not there, or may not be seen."""
    with suppress(OSError, ValueError):
        return path.stat().st_mode
    return None


def _is_folder(path: Path) -> bool:
    return stat.S_ISDIR(_mode(path) or 0)


def _existing(path: Path) -> Path | None:
    """Return the nearest folder or file above a path of which it can be seen that it is there."""
    with suppress(OSError):  # the working directory is gone
        return next((one for one in path.absolute().parents if _mode(one) is not None), None)
    return None


def _unwritable_store(config: GatewayConfig) -> Iterator[tuple[Place, str]]:
    path = store_file(config)
    if path is None:
        return
    target = _existing(path) if _mode(path) is None else path
    if target is None:
        return
    if _is_folder(target) and not os.access(target, os.X_OK):
        return  # what is in it cannot be seen, and may well be writable
    if not os.access(target, os.W_OK):
        what = "a folder or file of it" if isinstance(config.store.path, Secret) else f"'{target}'"
        text = (
            f"{what} cannot be written by the user of this command: make sure that the "
            "gateway's user can, or `rcpd serve` does not start"
        )
        yield ("store", "path"), text
