"""`${NAME}` and `${NAME:-default}` in the strings of a configuration, and what must not be shown."""

from __future__ import annotations

import os
import re
import tomllib
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import ConfigError
from rcp_protocol.plain import is_list, is_map

__all__ = ["Secret", "Withheld", "is_dear", "secrets_of", "substituted"]

_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^{}]*))?\}")
_DEAR = re.compile(r"(key|keys|sha256|token|secret|password|passphrase)(\[\d*\.*\])?$")
"""Keys of tables, of the kernel or plugins, whose values are secrets by name."""


class Secret(str):
    """A string from the environment: not shown in errors."""

    __slots__ = ()


class Withheld(Secret):
    """A string that is not shown in errors, as it may be secret."""

    __slots__ = ()


def is_dear(key: str) -> bool:
    """Return whether the value of a key is secret by its name."""
    return _DEAR.search(key) is not None


def substituted(text: str) -> str:
    """Replace the variables of a string; the result is a `Secret` if there are any.

    :raises ConfigError: a variable is not set and has no default, or has no end.
    """

    def found(match: re.Match[str]) -> str:
        value, default = os.environ.get(match[1]), match[2]
        if default is not None:
            return value or default
        if value is None:
            raise ConfigError(f"uses the environment variable {match[1]}, which is not set")
        return value

    if "${" in _VARIABLE.sub("", text):
        raise ConfigError(
            "has a `${` that names no variable: write ${NAME} or ${NAME:-default}, of letters, "
            "digits and `_`, and close it with `}`"
        )
    fresh = _VARIABLE.sub(found, text)
    return text if fresh == text else Secret(fresh)


def secrets_of(text: str) -> list[str]:
    """List what must not be shown of a file: values from the environment, and what keys call secret."""
    found: list[str] = []

    def note(node: Any, key: str) -> None:
        if is_map(node):
            for name, item in node.items():
                note(item, name)
        elif is_list(node):
            for item in node:
                note(item, key)
        elif isinstance(node, str):
            found.extend(os.environ.get(one[1], "") for one in _VARIABLE.finditer(node))
            if is_dear(key):
                found.append(node)

    with suppress(tomllib.TOMLDecodeError):
        note(tomllib.loads(text), "")
    return [value for value in found if value]
