"""Parsing of VALUE arguments: JSON, plain text, standard input or a file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from rcp_client.client import Client
from rcp_client.console.output import compact
from rcp_client.messages import ResourceInfo
from rcp_protocol.errors import BadRequest
from rcp_protocol.values import Encoding, parse

__all__ = ["fetch", "meant"]


def fetch(text: str) -> str:
    """Return the text itself, standard input for `-`, or the file of `@FILE`."""
    if text == "-":
        return sys.stdin.read()
    if not text.startswith("@"):
        return text
    try:
        return Path(text[1:]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise click.UsageError(f"cannot read {text[1:]}: {reason}") from error


async def meant(client: Client, path: str, text: str) -> Any:
    """Parse a VALUE for a path.

    :raises click.UsageError: it is not JSON, and the path accepts no plain text.
    """
    try:
        return parse(text.encode(), Encoding.JSON)
    except BadRequest:
        found = await client.discover(path)
    resource = found[0] if found else None
    if resource is None:
        return text  # the gateway reports what is wrong with the path
    schema = resource.schemas.get("value") or resource.schemas.get("input") or {}
    if _takes_text(schema, schema):
        return text.removesuffix("\n")
    raise click.UsageError(f"{_start(text)} is not valid JSON{_advice(resource)}")


def _takes_text(schema: dict[str, Any], root: dict[str, Any]) -> bool:
    if (reference := schema.get("$ref")) is not None:
        named = root.get("$defs", {}).get(reference.rpartition("/")[2], {})
        return _takes_text(named, root)
    kinds = schema.get("type", ())
    if kinds == "string" or "string" in kinds:
        return True
    if "enum" in schema:
        return any(isinstance(option, str) for option in schema["enum"])
    return any(_takes_text(option, root) for option in schema.get("anyOf", ()))


def _start(text: str) -> str:
    line = text.strip().partition("\n")[0]
    return repr(line if len(line) <= 40 else line[:37] + "...")


def _advice(resource: ResourceInfo) -> str:
    example = next((e for e in resource.examples if e is not None), None)
    return (
        "" if example is None else (f"; {resource.path} accepts, for example, '{compact(example)}'")
    )
