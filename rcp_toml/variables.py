"""`${NAME}`, `${NAME:-default}` and `${file:PATH}` in the strings of a configuration, and what must not be shown."""

from __future__ import annotations

import os
import re
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from rcp_protocol.errors import ConfigError
from rcp_protocol.plain import is_list, is_map
from rcp_toml.document import document
from rcp_toml.named_file import read_named

__all__ = ["NamedFile", "Secret", "Withheld", "files_of", "is_dear", "secrets_of", "substituted"]

_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^{}]*))?\}")
_FILE = re.compile(r"\$\{file:((?:[^${}]|\$\{[A-Za-z_][A-Za-z0-9_]*\})+)\}")
"""Its path may contain variables, such as systemd's `${CREDENTIALS_DIRECTORY}`."""
_LARGEST = 65_536  # bytes
_DEAR = re.compile(r"(key|keys|sha256|token|secret|password|passphrase)(\[\d*\.*\])?$")
"""Keys of tables, of the kernel or plugins, whose values are secrets by name."""


class NamedFile(NamedTuple):
    """A file that a string is read from."""

    name: str
    """As it is written, with its variables."""
    path: Path


class Secret(str):
    """A string from the environment: not shown in errors."""

    __slots__ = ()


class Withheld(Secret):
    """A string that is not shown in errors, as it may be secret."""

    __slots__ = ()


def is_dear(key: str) -> bool:
    """Return whether the value of a key is secret by its name."""
    return _DEAR.search(key) is not None


def substituted(text: str, folder: Path) -> str:
    """Replace the variables of a string; the result is a `Secret` if there are any.

    The paths of files are relative to `folder`.

    :raises ConfigError: a variable is not set and has no default, has no end, or a file cannot be read.
    """
    if "${" in _VARIABLE.sub("", _FILE.sub("", text)):
        raise ConfigError(
            "has a `${` that names no variable: write ${NAME}, ${NAME:-default} or ${file:PATH}, "
            "NAME of letters, digits and `_`, and close it with `}`"
        )
    pieces: list[str] = []
    end = 0
    for found in _FILE.finditer(text):  # what a file contains is taken as it is
        pieces += [_with_variables(text[end : found.start()]), _content(found[1], folder)]
        end = found.end()
    pieces.append(_with_variables(text[end:]))
    fresh = "".join(pieces)
    return text if fresh == text else Secret(fresh)


def files_of(text: str, folder: Path) -> list[NamedFile]:
    """Return the files that a string is read from.

    :raises ConfigError: a variable in the name of one is not set.
    """
    return [
        # Unlike Path.expanduser(), it leaves the `~` of an unknown user as it is.
        NamedFile(one[1], folder / os.path.expanduser(_with_variables(one[1])))  # noqa: PTH111
        for one in _FILE.finditer(text)
    ]


def _with_variables(text: str) -> str:
    def found(match: re.Match[str]) -> str:
        value, default = os.environ.get(match[1]), match[2]
        if default is not None:
            return value or default
        if value is None:
            raise ConfigError(f"uses the environment variable {match[1]}, which is not set")
        return value

    return _VARIABLE.sub(found, text)


def _content(name: str, folder: Path) -> str:
    """Return the text of a file, without the newlines at its end."""
    try:
        return read_named(_with_variables(name), folder, _LARGEST).rstrip("\r\n")
    except ConfigError as error:
        raise ConfigError(f"uses the file '{name}', which cannot be read: {error}") from None


def secrets_of(text: str, folder: Path) -> list[str]:
    """List what must not be shown of a file: of the environment, of other files, and what keys call secret."""
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
            for one in _FILE.finditer(node):
                with suppress(ConfigError):
                    found.append(_content(one[1], folder))
            if is_dear(key):
                found.append(node)

    with suppress(tomllib.TOMLDecodeError):
        note(document(text), "")
    return [value for value in found if value]
