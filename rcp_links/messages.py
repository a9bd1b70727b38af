"""What a link must know of a device's messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["Messages"]

M = TypeVar("M")


@dataclass(frozen=True)
class Messages(Generic[M]):
    """How requests are numbered, and what happens with everything else."""

    probe: Callable[[int], M]
    """Make a request under a number that changes nothing and that the device always answers."""
    answers: Callable[[M], int | None]
    """Return the number of the request that a message answers; None: it answers none."""
    handle: Callable[[M], None]
    """Take a message that answers no request, such as a measurement. ValueError ends the connection:
    the device speaks another language."""
