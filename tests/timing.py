"""Bounds on time: other programs on the machine may break one now and then, but not in each of three attempts."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from typing import ParamSpec

from rcp_gateway.testing._load import Load, measured_load

__all__ = ["Load", "in_one_of_three_attempts", "in_time", "in_time_under", "measured_load"]

_ATTEMPTS = 3
_MOST = 0.3  # s that a bound is longer at most, however busy the machine is
_BUSY = 0.05  # s lost from which on it is worth another attempt
_Asked = ParamSpec("_Asked")


class _LateError(AssertionError):
    """It took too long."""


def in_time(seconds: float, bound: float) -> None:
    """Have an attempt end if it took too long; whatever else fails ends the test."""
    if seconds >= bound:
        raise _LateError(f"it took {seconds:.3f} s, the bound is {bound:g} s")


def in_time_under(load: Load, seconds: float, bound: float) -> None:
    """Have it take less than the bound and the time that was lost to other programs meanwhile.

    Where they took next to nothing, it is late for its own reasons: that ends the test.
    """
    allowed = load.allows(bound, _MOST)
    if load.lost >= _BUSY:
        in_time(seconds, allowed)
    assert seconds < allowed, f"it took {seconds:.3f} s, the bound is {allowed:.3f} s"


def in_one_of_three_attempts(
    test: Callable[_Asked, Awaitable[None]],
) -> Callable[_Asked, Awaitable[None]]:
    """Try a test anew for as long as nothing but time spoke against it."""

    @functools.wraps(test)
    async def tried(*args: _Asked.args, **kwargs: _Asked.kwargs) -> None:
        for left in reversed(range(_ATTEMPTS)):
            try:
                await test(*args, **kwargs)
            except _LateError:
                if not left:
                    raise
            else:
                return

    return tried
