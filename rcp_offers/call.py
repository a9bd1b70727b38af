"""One call of what a client offers."""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

__all__ = ["Call", "Report"]


class Report(Protocol):
    """Tells who calls of progress."""

    def __call__(self, feedback: Any = None, *, fraction: float | None = None) -> None:
        """Send feedback, the part done, or both."""
        ...


class Call:
    """From its arrival to the answer of the client that offers."""

    __slots__ = ("answer", "cancelled", "id", "input", "report", "taken")

    def __init__(self, id_: str, input_: Any, report: Report) -> None:
        self.id = id_
        self.input = input_
        self.report = report
        self.answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.taken = False
        """Whether the client has begun with it."""
        self.cancelled = False
        """Whether the client is to cancel it."""
