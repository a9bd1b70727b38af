"""`rcpd config`: the configuration in force, defaults included and secrets hidden."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import click
import msgspec

from rcp_gateway.server import Prepared
from rcp_kernel.config.file import KERNEL_KEYS, TRANSPORTS
from rcp_protocol.plain import is_list, is_map
from rcp_toml.variables import is_dear
from rcpd.diagnosis import Diagnosis
from rcpd.exits import FAILED
from rcpd.reading import read

__all__ = ["config_command", "effective"]

_HIDDEN = "…"
_BARE = re.compile(r"[A-Za-z0-9_-]+\Z")


@click.command("config")
@click.argument("config", type=click.Path(path_type=Path), default="rcp.toml")
def config_command(config: Path) -> None:
    """Print the configuration in force as TOML: with every default, without secrets.

    Values from the environment, and those of keys, tokens and passwords, are shown as `…`.
    """
    found = Diagnosis(read(config), str(config))
    prepared = found.prepared()
    if prepared is None:
        for one in found.findings:
            click.echo(one.text(str(config)), err=True)
        sys.exit(FAILED)
    click.echo("\n".join(_toml(_hidden(effective(prepared), "", found.secrets), "")))


def effective(prepared: Prepared) -> dict[str, Any]:
    """Return everything that is in force, as in a file that says it all."""
    config = prepared.config
    found: dict[str, Any] = msgspec.to_builtins(config, enc_hook=str)
    del found["include"]  # its files are part of the rest
    found["backends"] = [
        {
            **{key: getattr(backend, key) for key in KERNEL_KEYS},
            **(backend.options if table is None else msgspec.to_builtins(table, enc_hook=str)),
        }
        for backend, table in zip(config.backends, prepared.backends, strict=True)
    ]
    off: dict[str, Any] = {name: False for name in TRANSPORTS if name not in config.transports}
    found["transports"] = {**found["transports"], **off, **_plain(prepared.transports)}
    found["plugins"] = {**found["plugins"], **_plain(prepared.adapters)}
    found["features"] = {
        **found["features"],
        **{
            one.kind.name: (msgspec.to_builtins(one.table, enc_hook=str) or True)
            if one.kind.table is None
            else True
            for one in prepared.features
        },
    }
    if config.anonymous.role is None and not config.anonymous.roles:
        found["anonymous"] = False
    return found


def _plain(tables: dict[str, Any]) -> dict[str, Any]:
    return {name: msgspec.to_builtins(table, enc_hook=str) for name, table in tables.items()}


def _hidden(node: Any, key: str, secrets: list[str]) -> Any:
    """Return the data without what must not be shown, and without what is not set."""
    if is_map(node):
        return {k: _hidden(item, k, secrets) for k, item in node.items() if item is not None}
    if isinstance(node, (list, tuple)):
        return [_hidden(item, key, secrets) for item in cast("Sequence[Any]", node)]
    if not isinstance(node, str):
        return node
    shown = any(secret in node for secret in secrets if node == secret or len(secret) > 4)
    return _HIDDEN if shown or is_dear(key) else node


def _toml(table: dict[str, Any], path: str) -> Iterator[str]:
    """Yield the lines of a table: its values first, then its tables."""
    inner: dict[str, Any] = {}
    for key, item in table.items():
        if is_map(item) or (is_list(item) and item and all(map(is_map, item))):
            inner[key] = item
        else:
            yield f"{_key(key)} = {_value(item)}"
    for key, item in inner.items():
        at = f"{path}.{_key(key)}" if path else _key(key)
        tables: list[dict[str, Any]] = item if is_list(item) else [item]
        for one in tables:
            yield ""
            yield f"[[{at}]]" if is_list(item) else f"[{at}]"
            yield from _toml(one, at)


def _key(key: str) -> str:
    return key if _BARE.match(key) else _value(key)


def _value(item: Any) -> str:
    if isinstance(item, str):
        return msgspec.json.encode(item).decode().replace("\x7f", "\\u007f")
    if isinstance(item, bool):
        return "true" if item else "false"
    if is_list(item):
        return f"[{', '.join(map(_value, item))}]"
    if is_map(item):
        pairs = (f"{_key(key)} = {_value(one)}" for key, one in item.items())
        return f"{{ {', '.join(pairs)} }}" if item else "{}"
    return str(item)
