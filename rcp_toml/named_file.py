"""Files that a configuration names."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rcp_protocol.errors import ConfigError
from rcp_toml.encoding import decoded

__all__ = ["read_named"]


def read_named(name: str, folder: Path, limit: int) -> str:
    """Return the text of a regular file, relative to a folder; never waits for what is none.

    :raises ConfigError: the reason, to stand behind "which cannot be read: ".
    """
    try:
        path = folder / Path(name).expanduser()
        opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # of a pipe: at once
        with os.fdopen(opened, "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ConfigError("it is not a regular file")
            data = file.read(limit + 1)
        if len(data) > limit:
            raise ConfigError(f"it is longer than {limit} bytes")
        return decoded(data)
    except OSError as error:
        raise ConfigError(error.strerror or str(error)) from None
    except (RuntimeError, ValueError) as error:  # an unknown user's `~`, a NUL
        raise ConfigError(str(error)) from None
