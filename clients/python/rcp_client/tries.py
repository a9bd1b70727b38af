"""How long, and how often, something is asked for again that is not there yet."""

from __future__ import annotations

import asyncio
import time

from rcp_protocol.errors import RcpError

__all__ = ["Tries"]

_FIRST = 0.1  # s
_LONGEST = 5.0  # s


class Tries:
    """Pauses between tries, growing, until patience ends."""

    def __init__(self, patience: float | None) -> None:
        self._patience = patience
        """Seconds in all; None never ends."""
        self._began = time.monotonic()
        self._pause = _FIRST

    async def again(self, error: RcpError) -> bool:
        """Wait until the next try, as long as the refusal asks for at least; False: no more."""
        passed = time.monotonic() - self._began
        if self._patience is not None and passed > self._patience:
            return False
        await asyncio.sleep(max(self._pause, error.retry_after or 0.0))
        self._pause = min(self._pause * 2, _LONGEST)
        return True
