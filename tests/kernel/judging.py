"""How many paths the rules judge in one turn of the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager

import pytest

from rcp_kernel.access.acl import Rights

__all__ = ["AT_ONCE", "judged"]

AT_ONCE = 2_000  # paths in one turn that is shared with others, on a machine of any speed


@contextmanager
def judged(monkeypatch: pytest.MonkeyPatch) -> Generator[list[int]]:
    """Count the paths that the rules judge in each turn of the loop."""
    turns, usual = [0], Rights.compute_mask

    def compute_mask(self: Rights, path: str) -> int:
        turns[-1] += 1
        return usual(self, path)

    def turn() -> None:
        turns.append(0)
        nonlocal handle
        handle = asyncio.get_running_loop().call_soon(turn)

    monkeypatch.setattr(Rights, "compute_mask", compute_mask)
    handle = asyncio.get_running_loop().call_soon(turn)
    yield turns
    handle.cancel()
