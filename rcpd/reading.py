"""A configuration file as its commands read it."""

from __future__ import annotations

from pathlib import Path

from rcp_toml.encoding import NotUtf8, decoded
from rcpd.exits import fail
from rcpd.survey import Finding

__all__ = ["read", "text_of"]


def text_of(path: Path) -> str | Finding:
    """Return the text of a file, or why it cannot be read."""
    try:
        return decoded(path.read_bytes())
    except NotUtf8 as error:
        return Finding(error.line, "", None, str(error))
    except IsADirectoryError:
        return Finding(1, "", None, "is a folder: name the file in it")
    except OSError as error:
        advice = "; `rcpd init` writes one" if isinstance(error, FileNotFoundError) else ""
        return Finding(1, "", None, f"cannot be read: {error.strerror or error}{advice}")


def read(path: Path) -> str:
    """Return the text of a file, or end the program and say why it cannot be read."""
    found = text_of(path)
    if isinstance(found, Finding):
        fail(found.text(str(path)))
    return found
