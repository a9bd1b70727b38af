"""Work that is done in steps, for tests that have no other work to share the loop with."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

Result = TypeVar("Result")


def finished(work: Generator[None, None, Result]) -> Result:
    """Do all steps at once; return what they come to."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value
