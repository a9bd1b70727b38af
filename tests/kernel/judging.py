"""How many paths come under rules in one turn of the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager
from time import thread_time

import pytest

from rcp_kernel.access.acl import Rights

__all__ = ["AT_ONCE", "judged"]

AT_ONCE = 2_000  # paths in one turn that is shared with others
_LEAST = 5e-6  # s that each is made to take, so that no machine is fast enough for more of them


@contextmanager
def judged(monkeypatch: pytest.MonkeyPatch) -> Generator[list[int]]:
    """Count the paths that come under rules in each turn of the loop."""
    turns, usual = [0], Rights.remember

    def remember(self: Rights, path: str, mask: int) -> None:
        turns[-1] += 1
        until = thread_time() + _LEAST
        usual(self, path, mask)
        while thread_time() < until:
            pass

    def turn() -> None:
        turns.append(0)
        nonlocal handle
        handle = asyncio.get_running_loop().call_soon(turn)

    monkeypatch.setattr(Rights, "remember", remember)
    handle = asyncio.get_running_loop().call_soon(turn)
    yield turns
    handle.cancel()
