"""Scaffolds of plugins: a distribution that passes the public test suite.

Each contains a small example, so that every part already has its place: a backend a simulated
linear axis, the others the example of their tutorials. The author replaces it.
"""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from rcp_kernel.errors import ConfigError

__all__ = ["KINDS", "write_plugin"]

_NAME = re.compile(r"[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*\Z")
_LONGEST = 40  # characters


class _Kind(NamedTuple):
    """The differences between the kinds of plugins."""

    group: str
    """Its entry point group, without `rcp.`."""
    table: str
    """Its table in the configuration."""
    page: str
    """Its tutorial."""
    readme: str = "README_client.md"
    needs: str = '"pytest>=8.3"'
    """Requirements of its tests."""


KINDS = {
    "backend": _Kind("backends", "backends", "Write a backend", "README_backend.md"),
    "transport": _Kind("transports", "transports", "Write a transport"),
    "adapter": _Kind(
        "plugins", "plugins", "Write an adapter", needs='"httpx>=0.28", "pytest>=8.3"'
    ),
    "feature": _Kind("features", "features", "Write a feature"),
}


def write_plugin(kind: str, name: str, into: Path) -> Path:
    """Write `rcp-<kind>-<name>` below a folder, for one of `KINDS`; return the new folder.

    :raises ConfigError: the name is not a valid package name, or the folder already exists.
    """
    if not _NAME.match(name) or len(name) > _LONGEST:
        raise ConfigError(
            f"{name[:60]!r} is not a valid {kind} name: use lower-case letters, digits and "
            "single dashes, starting with a letter, at most 40 characters"
        )
    dashed, word = name.replace("_", "-"), name.replace("-", "_")
    made = into / f"rcp-{kind}-{dashed}"
    if made.exists():
        raise ConfigError(f"{made} already exists: choose another name")
    facts = _facts(kind, dashed, word)
    try:
        for template, place in _templates(kind, word).items():
            file = made / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(_filled(template, facts), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{made} cannot be written: {error.strerror or error}") from error
    return made


def _templates(kind: str, word: str) -> dict[str, str]:
    return {
        "pyproject.toml": "pyproject.toml",
        KINDS[kind].readme: "README.md",
        f"{kind}.py": f"rcp_{word}/__init__.py",
        "py.typed": f"rcp_{word}/py.typed",
        f"test_{kind}.py": f"tests/test_{word}.py",
    }


def _facts(kind: str, dashed: str, word: str) -> dict[str, str]:
    of = KINDS[kind]
    return {
        "@kind@": kind,
        "@n@": "n" if kind[0] in "aeiou" else "",
        "@group@": of.group,
        "@table@": of.table,
        "@page@": of.page,
        "@test@": of.needs,
        "@name@": dashed,
        "@word@": word,
        "@WORD@": word.upper(),
        "@Word@": "".join(part.capitalize() for part in word.split("_")),
    }


def _filled(template: str, facts: dict[str, str]) -> str:
    source = files("rcpd").joinpath("templates", template + ".in")
    text = source.read_text(encoding="utf-8")
    for mark, fact in facts.items():
        text = text.replace(mark, fact)
    return text
