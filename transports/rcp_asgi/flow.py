"""Flow control of a connection: reading pauses while received bytes are still to be parsed."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.flow_control import FlowControl

__all__ = ["ReadFlow"]


class ReadFlow(FlowControl):
    """Uvicorn's flow control, with a hold that `resume_reading` does not override."""

    def __init__(self, transport: asyncio.Transport) -> None:
        super().__init__(transport)
        self._held = False

    def hold(self) -> None:
        """Pause reading until `release`."""
        self._held = True
        self.pause_reading()

    def release(self) -> None:
        """End the hold; uvicorn's own flow control decides again."""
        self._held = False

    def resume_reading(self) -> None:
        """Resume reading, unless it is held."""
        if self.read_paused and not self._held:
            super().resume_reading()
