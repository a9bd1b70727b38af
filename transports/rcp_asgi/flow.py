"""When a connection is read from: not while bytes that were read already wait to be parsed."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.flow_control import FlowControl

__all__ = ["ReadFlow"]


class ReadFlow(FlowControl):
    """Uvicorn's flow control, with a hold that whoever resumes reading cannot undo."""

    def __init__(self, transport: asyncio.Transport) -> None:
        super().__init__(transport)
        self._held = False

    def hold(self) -> None:
        """Stop reading until `release`."""
        self._held = True
        self.pause_reading()

    def release(self) -> None:
        """Leave it to the others again whether anything is read."""
        self._held = False

    def resume_reading(self) -> None:
        """Read on, unless it is held."""
        if self.read_paused and not self._held:
            super().resume_reading()
