"""Bounds on time: other programs on the machine may break one now and then, but not in each of three attempts."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from typing import ParamSpec

__all__ = ["in_one_of_three_attempts", "in_time"]

_ATTEMPTS = 3
_Asked = ParamSpec("_Asked")


class _LateError(AssertionError):
    """It took too long."""


def in_time(seconds: float, bound: float) -> None:
    """Have an attempt end if it took too long; whatever else fails ends the test."""
    if seconds >= bound:
        raise _LateError(f"it took {seconds:.3f} s, the bound is {bound:g} s")


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
