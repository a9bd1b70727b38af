"""Write the beginning of a backend: a distribution of its own that passes the public suite.

The device in it is a small linear axis, simulated in the module, so that every part of a backend
has a place already: a sensor, a param, an actuator and an action. Its author replaces it.
"""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from rcp_kernel.errors import ConfigError

__all__ = ["write_backend"]

_NAME = re.compile(r"[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*\Z")
_LONGEST = 40  # characters
_TEMPLATES = {
    "pyproject.toml": "pyproject.toml",
    "README.md": "README.md",
    "backend.py": "rcp_{word}/__init__.py",
    "py.typed": "rcp_{word}/py.typed",
    "test_backend.py": "tests/test_{word}.py",
}


def write_backend(name: str, into: Path) -> Path:
    """Write `rcp-backend-<name>` below a folder; return the folder it made.

    :raises ConfigError: the name cannot be a package's, or the folder is there already.
    """
    if not _NAME.match(name) or len(name) > _LONGEST:
        raise ConfigError(
            f"{name[:60]!r} is not a valid backend name: use lower-case letters, digits and "
            "single dashes, starting with a letter, at most 40 characters"
        )
    dashed, word = name.replace("_", "-"), name.replace("-", "_")
    made = into / f"rcp-backend-{dashed}"
    if made.exists():
        raise ConfigError(f"{made} already exists: choose another name")
    facts = {"@name@": dashed, "@word@": word, "@Word@": _camel(word)}
    try:
        for template, place in _TEMPLATES.items():
            file = made / place.format(word=word)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(_filled(template, facts), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{made} cannot be written: {error.strerror or error}") from error
    return made


def _camel(word: str) -> str:
    return "".join(part.capitalize() for part in word.split("_"))


def _filled(template: str, facts: dict[str, str]) -> str:
    source = files("rcpd").joinpath("templates", template + ".in")
    text = source.read_text(encoding="utf-8")
    for mark, fact in facts.items():
        text = text.replace(mark, fact)
    return text
