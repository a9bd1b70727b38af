"""The configuration of a replay."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.errors import ConfigError

__all__ = ["ReplayConfig", "found", "lacking"]

_SUFFIX = ".mcap"


class ReplayConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which recordings are played, and how."""

    files: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Recordings, or folders of them, which are played as one."""
    speed: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    """How many times as fast as it was recorded."""
    loop: bool = False
    """Begin again at the end."""
    paused: bool = False
    """Wait at the beginning until it is told to play."""


def found(config: ReplayConfig) -> list[Path]:
    """List the files.

    :raises ConfigError: there are none.
    """
    files: list[Path] = []
    for text in config.files:
        path = Path(text)
        some = sorted(path.glob(f"*{_SUFFIX}")) if path.is_dir() else [path]
        missing = [one for one in some if not one.is_file()] or ([] if some else [path])
        if missing:
            raise ConfigError(f"replay: there is no recording at {missing[0]}")
        files += some
    return files


def lacking(config: ReplayConfig) -> str | None:
    """Return which recording is not there, or None."""
    try:
        found(config)
    except ConfigError as error:
        return str(error)
    return None
