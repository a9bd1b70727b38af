"""The formats of `rcpctl -o`: how one document is written for a program."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import click
import msgspec

from rcp_client.console.extra import needs
from rcp_protocol.values import Encoding, dump

__all__ = ["FORMATS", "Writer", "as_json", "writer_of"]

FORMATS = ("table", "json", "yaml", "jsonpath=EXPR")
_JSONPATH = "jsonpath="
Writer = Callable[[Any], bytes]


def writer_of(wanted: str) -> Writer | None:
    """Return what writes a document in a format; None for tables.

    :raises click.UsageError: there is no such format, or its expression is wrong.
    """
    if wanted == "table":
        return None
    if wanted == "json":
        return as_json
    if wanted == "yaml":
        return _yaml()
    if wanted.startswith(_JSONPATH):
        return _jsonpath(wanted.removeprefix(_JSONPATH))
    raise click.UsageError(f"-o {wanted!r}: write one of {', '.join(FORMATS)}")


def as_json(value: Any) -> bytes:
    """Write a complete value as one line of JSON."""
    return dump(msgspec.to_builtins(value, builtin_types=(bytes,)), Encoding.JSON) + b"\n"


def _plain(value: Any) -> Any:
    """Return a value as JSON would have it, with base64 for bytes."""
    return msgspec.json.decode(as_json(value))


def _yaml() -> Writer:
    with needs("-o yaml"):
        import yaml

    def write(value: Any) -> bytes:
        text = yaml.safe_dump(_plain(value), sort_keys=False, allow_unicode=True)
        return f"---\n{text}".encode()

    return write


def _jsonpath(text: str) -> Writer:
    with needs("-o jsonpath"):
        import jsonpath

    expression = text.strip()
    if expression.startswith("{"):  # as kubectl has it
        if not expression.endswith("}"):
            raise click.UsageError(f"-o jsonpath={text}: a }} is missing at its end")
        expression = expression[1:-1]
    if not expression.startswith("$"):
        expression = f"${expression}" if expression.startswith((".", "[")) else f"$.{expression}"
    try:
        query = jsonpath.compile(expression)
    except jsonpath.JSONPathError as error:
        raise click.UsageError(f"-o jsonpath={text}: {error}") from error

    def lines(value: Any) -> Iterator[bytes]:
        for found in query.findall(_plain(value)):
            yield found.encode() + b"\n" if isinstance(found, str) else as_json(found)

    return lambda value: b"".join(lines(value))
