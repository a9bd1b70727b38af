"""`rcpd schema`: the JSON Schema of the configuration file, with the tables of the installed plugins."""

from __future__ import annotations

import importlib
from contextlib import suppress
from typing import Any

import click
import msgspec

from rcp_gateway.plugins import GROUPS, installed
from rcp_kernel.config.file import KERNEL_KEYS, BackendConfig, GatewayConfig
from rcp_protocol.plain import is_list, is_map

__all__ = ["json_schema", "schema"]

_HOOKS = {
    "backends": "rcp_backends",
    "transports": "rcp_transports",
    "plugins": "rcp_adapters",
    "features": "rcp_features",
}
_FROM_ENVIRONMENT = {"type": "string", "pattern": r"\$\{"}
"""A string that the environment completes fits wherever a string does."""


@click.command()
def schema() -> None:
    """Print the JSON Schema of the configuration file, for Taplo and other editors.

    It contains the tables of the plugins that are installed.
    """
    click.echo(msgspec.json.format(msgspec.json.encode(json_schema())))


def json_schema() -> dict[str, Any]:
    """Return the schema (draft 2020-12)."""
    kinds = {group: _kinds(group) for group in GROUPS}
    features = kinds["features"]
    own = {name: kind for name, kind in features.items() if kind.table is None}
    tables = _top_level(kind.config for kind in features.values() if kind.table is not None)
    types = [
        GatewayConfig,
        BackendConfig,
        *(kind.config for group in kinds.values() for kind in group.values()),
        *tables.values(),
    ]
    refs, defs = msgspec.json.schema_components(types, ref_template="#/$defs/{name}")
    of = dict(zip(map(id, types), refs, strict=True))
    defs = {name: _with_variables(one) for name, one in defs.items()}
    root = defs.pop("GatewayConfig")
    properties: dict[str, Any] = root["properties"]
    properties["backends"]["items"] = _backend(
        defs,
        {name: _resolved(of[id(kind.config)], defs) for name, kind in kinds["backends"].items()},
    )
    properties["transports"] = _closed(
        {
            name: {"anyOf": [of[id(kind.config)], {"const": False}]}
            for name, kind in kinds["transports"].items()
        }
    )
    properties["plugins"] = _closed(
        {name: of[id(kind.config)] for name, kind in kinds["plugins"].items()}
    )
    properties["features"] = _closed(
        {
            name: {"anyOf": [{"type": "boolean"}, of[id(own[name].config)]]}
            if name in own
            else {"type": "boolean"}
            for name in features
        }
    )
    anonymous = properties["anonymous"]
    properties["anonymous"] = {"anyOf": [anonymous, {"const": False}]}
    for name, type_ in tables.items():
        properties[name] = _with_variables(of[id(type_)])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **root,
        "title": "Configuration of an RCP gateway",
        "$defs": defs,
    }


def _kinds(group: str) -> dict[str, Any]:
    """Return what the installed plugins of a group offer; one that lacks a library has none."""
    found: dict[str, Any] = {}
    for _, point in sorted(installed(group).items()):
        with suppress(ImportError):
            offer = getattr(importlib.import_module(point.value), _HOOKS[group], None)
            found |= {kind.name: kind for kind in (offer() if offer else ())}
    return dict(sorted(found.items()))


def _top_level(tables: Any) -> dict[str, Any]:
    """Return the types of the top-level keys that features decode themselves."""
    loose = {
        field.encode_name
        for field in msgspec.structs.fields(GatewayConfig)
        if field.type in (dict[str, Any], tuple[dict[str, Any], ...])
    }
    return {
        field.encode_name: field.type
        for table in tables
        for field in msgspec.structs.fields(table)
        if field.encode_name in loose
    }


def _closed(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _resolved(node: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any]:
    return defs[node["$ref"].removeprefix("#/$defs/")]


def _backend(defs: dict[str, Any], kinds: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the schema of `[[backends]]`: one set of keys for each plugin."""
    kernel = defs.pop("BackendConfig")
    own = {key: kernel["properties"][key] for key in KERNEL_KEYS}
    return {
        "type": "object",
        "description": kernel["description"],
        "required": ["use", "tenant"],
        "properties": {**own, "use": {"enum": list(kinds)}},
        "allOf": [
            {
                "if": {"properties": {"use": {"const": name}}, "required": ["use"]},
                "then": {
                    **_closed({**kind.get("properties", {}), **own}),
                    "required": kind.get("required", []),
                },
            }
            for name, kind in kinds.items()
        ],
    }


def _with_variables(node: Any) -> Any:
    """Let a string of each form come from the environment."""
    if is_list(node):
        return [_with_variables(item) for item in node]
    if not is_map(node):
        return node
    plain = {
        key: item if key in ("propertyNames", "default", "enum") else _with_variables(item)
        for key, item in node.items()
    }
    texts = node.get("enum", [])
    bound = {"pattern", "minLength", "maxLength", "format"} & node.keys()
    if (node.get("type") == "string" and bound) or any(isinstance(text, str) for text in texts):
        return {"anyOf": [plain, _FROM_ENVIRONMENT]}
    return plain
