"""The common part of the suites: each test names the requirement it proves."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar, TypeVar

import pytest

from rcp_gateway.testing._client import BOUND
from rcp_protocol.timeouts import timeout

__all__ = ["Suite", "eventually", "proves"]

_Test = TypeVar("_Test", bound=Callable[..., Any])
_LOOK = 0.005  # s between two looks at a device that has no events


def proves(*ids: str) -> Callable[[_Test], _Test]:
    """Link a test to the requirements that it proves."""

    def mark(test: _Test) -> _Test:
        test.__dict__["proves"] = ids
        return test

    return mark


async def eventually(
    holds: Callable[[], Awaitable[bool]], what: str, within: float = BOUND
) -> None:
    """Wait until something holds of a device that can only be polled.

    :raises AssertionError: it did not within `within` seconds.
    """
    try:
        async with timeout(within):
            while not await holds():  # noqa: ASYNC110 - devices have no events
                await asyncio.sleep(_LOOK)
    except TimeoutError:
        raise AssertionError(f"{what}: not within {within} s") from None


class Suite:
    """A class of tests to subclass; a subclass provides what the tests need and changes none."""

    pytestmark: ClassVar[Any] = pytest.mark.anyio

    @pytest.fixture
    def anyio_backend(self) -> str:
        """Run on asyncio: the kernel's event loop."""
        return "asyncio"

    @classmethod
    def altered(cls, suite: type[Suite]) -> list[str]:
        """List the tests of a suite that a subclass replaced or took out without a reason."""
        names = [name for name in dir(suite) if name.startswith("test_")]
        return [name for name in names if not _kept(cls, suite, name)]


def _kept(cls: type[Suite], suite: type[Suite], name: str) -> bool:
    own = getattr(cls, name, None)
    if own is getattr(suite, name):
        return True
    marks: list[Any] = getattr(own, "pytestmark", [])
    return any(mark.name == "xfail" and mark.kwargs.get("reason") for mark in marks)
