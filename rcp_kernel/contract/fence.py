"""Permits: they keep commands admitted before a stop from reaching the robot after it.

The kernel runs each write and command under a permit, a context variable that tasks and timers
inherit. A stop revokes the permits of its robot. Backends call `check_fence` before they send
anything that moves, so that the clean-up of a cancelled action cannot overtake the stop, in
whatever order the two run. A stop itself runs under no permit and always passes.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

from rcp_kernel.contract.caller import request_context
from rcp_kernel.errors import EstopActive

__all__ = [
    "Fenced",
    "check_fence",
    "current_permit",
    "end_permit",
    "fenced_off",
    "is_commanded",
    "permit",
    "permitted",
    "unfenced",
]


class Fenced(Protocol):
    """A unit that is stopped as a whole and counts its stops."""

    name: str

    @property
    def stops(self) -> int:
        """The number of stops so far."""
        ...


current_permit: ContextVar[tuple[Fenced, int] | None] = ContextVar("rcp_permit", default=None)
"""The permit of what runs now: a unit, and its count of stops when the request was admitted; set by
the kernel."""


class permitted:  # noqa: N801 - used as a function is
    """Run the body under a permit that the next stop of `unit` revokes.

    `stops` is the unit's count when the request was admitted.
    """

    __slots__ = ("_permitted", "_token")

    def __init__(self, unit: Fenced, stops: int) -> None:
        self._permitted = (unit, stops)

    def __enter__(self) -> None:
        self._token = current_permit.set(self._permitted)

    def __exit__(self, *_: object) -> None:
        current_permit.reset(self._token)


def permit(unit: Fenced, stops: int) -> None:
    """Run the rest of the current task under such a permit."""
    current_permit.set((unit, stops))


def end_permit() -> None:
    """Run the rest of the current task without a permit and caller: its robot has answered."""
    current_permit.set(None)
    request_context.set(None)


@contextmanager
def unfenced() -> Generator[None]:
    """Run the body without a permit and caller: a stop, or work that outlives its request."""
    token, caller = current_permit.set(None), request_context.set(None)
    try:
        yield
    finally:
        request_context.reset(caller)
        current_permit.reset(token)


def fenced_off() -> bool:
    """Return whether the robot was stopped after the current operation was admitted."""
    permit = current_permit.get()
    return permit is not None and permit[0].stops != permit[1]


def is_commanded() -> bool:
    """Return whether a client requested the current operation: it is no stop of the gateway's own."""
    return current_permit.get() is not None


def check_fence() -> None:
    """Refuse to move anything for a request admitted before a stop.

    :raises EstopActive: the robot has been stopped since.
    """
    if fenced_off():
        permit = current_permit.get()
        assert permit is not None
        raise EstopActive(f"{permit[0].name} was stopped after this command was sent")
