"""Configurations of gateways under test: each function writes a table, as an operator would.

Tables are added: `listener() + backend("rover", use="sim") + key("admin", ADMIN)`. A test writes as
TOML what it is itself about: the table that it tests, or a faulty file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from certs import Signed

__all__ = ["backend", "configuration", "key", "listener", "role", "rule", "table", "tls"]


def configuration(*tables: str) -> str:
    """Write a configuration of some tables that opens no transport."""
    return table("transports", asgi=False, http=False, ws=False, sse=False) + "".join(tables)


def listener(port: int = 0, **fields: Any) -> str:
    """Write where the gateway listens: at a free port, unless one is given."""
    return table("transports.asgi", port=port, **fields)


def tls(server: Signed, **fields: Any) -> str:
    """Write the listener's certificate and key; it comes after the listener."""
    pair = {"certificate": server.cert, "key": server.key}
    return table("transports.asgi.tls", **{**pair, **fields})


def backend(name: str | None = None, tenant: str = "alpha", **fields: Any) -> str:
    """Write one backend: the test's robot, unless `use` names another kind."""
    named = {} if name is None else {"name": name}
    return _table("[[backends]]", {"use": "robot", **named, "tenant": tenant, **fields})


def key(name: str, secret: str, **fields: Any) -> str:
    """Write an API key; its role has its name, unless `role` or `roles` says which."""
    held = {} if {"role", "roles"} & fields.keys() else {"role": name}
    return _table("[[keys]]", {"name": name, **held, **fields, "key": secret})


def role(name: str, *allow: Mapping[str, Any], **fields: Any) -> str:
    """Write a role by the rules of what it allows."""
    return table(f"roles.{name}", **({"allow": allow} if allow else {}), **fields)


def rule(operations: str, *paths: str, **fields: Any) -> dict[str, Any]:
    """Write a rule: its operations, with spaces between them, and the paths that it is about."""
    return {"operations": operations.split(), "paths": paths, **fields}


def table(head: str, **fields: Any) -> str:
    """Write a table of any other kind."""
    return _table(f"[{head}]", fields)


def _table(head: str, fields: Mapping[str, Any]) -> str:
    return "".join([f"\n{head}\n", *(f"{_name(n)} = {_value(v)}\n" for n, v in fields.items())])


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_name(name)} = {_value(each)}" for name, each in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, default=str)  # a path, too


def _name(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name) else json.dumps(name)
