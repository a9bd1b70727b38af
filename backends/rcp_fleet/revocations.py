"""Publishes the list of revoked hubs to the robots: on every change, and again and again."""

from __future__ import annotations

import asyncio
from pathlib import Path

import structlog
import zenoh

from rcp_zenoh.keys import revoked

__all__ = ["Revocations"]

log = structlog.get_logger("rcp.fleet")
_PERIOD = 10.0  # s between two publications
_LOOK = 1.0  # s between two looks at the file


class Revocations:
    """The list in a file, which any hub may repeat: it is signed."""

    def __init__(self, session: zenoh.Session, tenant: str, file: str) -> None:
        self._session, self._key = session, revoked(tenant)
        self._file = Path(file).expanduser()
        self._due = 0.0
        self._readable = True

    def hasten(self) -> None:
        """Publish it soon: a robot has come that may not know it."""
        self._due = 0.0

    async def run(self) -> None:
        """Publish it."""
        loop, last = asyncio.get_running_loop(), b""
        while True:
            data = await asyncio.to_thread(self._read)
            if data and (data != last or loop.time() >= self._due):
                self._session.put(self._key, data, congestion_control=zenoh.CongestionControl.DROP)
                last, self._due = data, loop.time() + _PERIOD
            await asyncio.sleep(_LOOK)

    def _read(self) -> bytes:
        try:
            data = self._file.read_bytes().strip()
        except OSError as error:
            if self._readable:
                log.error("fleet_revocations_unreadable", file=str(self._file), reason=str(error))
            self._readable = False
            return b""
        self._readable = True
        return data
