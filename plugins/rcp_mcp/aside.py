"""Work for one client that must not keep the others waiting."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from rcp_mcp.summary import size

__all__ = ["aside"]

T = TypeVar("T")
_HEAVY = 200_000  # bytes of JSON above which pictures and summaries are made in a thread


async def aside(plain: Any, make: Callable[[], T]) -> T:
    """Make something of a value: at once, or in a thread if the value is large."""
    return make() if size(plain) < _HEAVY else await asyncio.to_thread(make)
