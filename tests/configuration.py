"""Configurations of gateways under test, as the text that an operator would write.

A test writes as TOML only what it is about, and adds it: `configuration(backend(), key("admin")) + MORE`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

__all__ = ["backend", "configuration", "key"]

_TRANSPORTS = ("asgi", "http", "ws", "sse")


def configuration(
    *tables: str, top: str = "", transports: Mapping[str, Mapping[str, Any]] | None = None
) -> str:
    """Write a configuration of some tables; it opens only the `transports` named.

    `top` has the keys that stand before every table.
    """
    opened = transports or {}
    off = {name: False for name in _TRANSPORTS if name not in opened}
    wires = [_table(f"[transports.{name}]", table) for name, table in opened.items()]
    return "\n".join([top, _table("[transports]", off), *wires, *tables])


def backend(name: str | None = None, tenant: str = "alpha", **fields: Any) -> str:
    """Write one backend: the test's robot, unless `use` names another kind."""
    named = {} if name is None else {"name": name}
    return _table("[[backends]]", {"use": "robot", **named, "tenant": tenant, **fields})


def key(name: str, secret: str, **fields: Any) -> str:
    """Write an API key; its role has its name, unless `role` or `roles` says which."""
    role = {} if {"role", "roles"} & fields.keys() else {"role": name}
    return _table("[[keys]]", {"name": name, **role, **fields, "key": secret})


def _table(head: str, fields: Mapping[str, Any]) -> str:
    lines = [f"{name} = {_value(value)}" for name, value in fields.items()]
    return "\n".join([head, *lines, ""])


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{name} = {_value(each)}" for name, each in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value)
