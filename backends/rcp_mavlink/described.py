"""Parameter metadata, from a local file, a file on board, or what the vehicle offers."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path

import structlog

from rcp_kernel.errors import ConfigError, RcpError
from rcp_mavlink.component_metadata import ComponentMetadata
from rcp_mavlink.files import FileRange, Files
from rcp_mavlink.metadata import About
from rcp_mavlink.parameter_metadata import described

__all__ = ["Described", "checked"]

_ON_BOARD = "ftp:"
_BY_ITSELF = "vehicle"
log = structlog.get_logger("rcp.mavlink")
_LARGEST = 32 << 20  # bytes


def checked(source: str | None) -> None:
    """Check that a metadata file exists and is valid.

    :raises ConfigError: it does not exist or is not a metadata file.
    """
    if source in (None, _BY_ITSELF) or source.startswith(_ON_BOARD):
        return
    try:
        described(Path(source).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"`parameters`: {source}: {error}") from error


class Described:
    """Metadata of one vehicle's parameters; empty without a source."""

    def __init__(self, source: str | None, files: Files, offered: ComponentMetadata) -> None:
        self._source, self._files, self._offered = source, files, offered
        self._known: Mapping[str, About] = {}

    async def load(self) -> Mapping[str, About]:
        """Return the metadata; an on-board file is read once."""
        source = self._source
        if source is None or self._known:
            return self._known
        try:
            data = await self._read(source)
            self._known = await asyncio.to_thread(described, data)
        except (OSError, ValueError, RcpError) as error:
            log.warning("no_parameter_metadata", source=source, error=str(error))
            return {}  # all vehicles with this file have the same parameters
        return self._known

    async def _read(self, source: str) -> bytes:
        if source == _BY_ITSELF:
            return await self._offered.parameters()
        if not source.startswith(_ON_BOARD):
            return await asyncio.to_thread(Path(source).read_bytes)
        whole, path = b"", source.removeprefix(_ON_BOARD)
        while len(whole) < _LARGEST:
            piece = await self._files.read(FileRange(path, len(whole)), _silent)
            whole += piece.data
            if piece.end:
                return whole
        raise ValueError(f"{path} is too large")


def _silent(feedback: object = None, *, fraction: float | None = None) -> None:
    """Discard the progress."""
