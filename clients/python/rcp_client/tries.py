"""Retries with growing pauses."""

from __future__ import annotations

import asyncio
import time

from rcp_protocol.errors import RcpError

__all__ = ["Tries"]

_FIRST = 0.1  # s
_LONGEST = 5.0  # s


class Tries:
    """Growing pauses between attempts, until patience ends."""

    def __init__(self, patience: float | None) -> None:
        self._patience = patience
        """Total time in s; None never ends."""
        self._began = time.monotonic()
        self._pause = _FIRST

    async def again(self, error: RcpError) -> bool:
        """Wait for the next attempt, at least `error.retry_after`; False if patience ended."""
        passed = time.monotonic() - self._began
        if self._patience is not None and passed > self._patience:
            return False
        await asyncio.sleep(max(self._pause, error.retry_after or 0.0))
        self._pause = min(self._pause * 2, _LONGEST)
        return True
