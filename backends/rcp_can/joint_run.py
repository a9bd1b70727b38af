"""A motion of several joints, from its first set-point until every drive reports arrival."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import anyio

from rcp_can import motor_messages as m
from rcp_can.axis import Axis
from rcp_can.motor import abandon, drive_to
from rcp_can.standstill import rested
from rcp_can.together import together
from rcp_kernel.errors import RcpError
from rcp_kernel.spi import fenced_off

__all__ = ["Follow", "JointRun", "Line"]

_POLL_PERIOD = 0.01  # s
Follow = Callable[[], tuple[float, float]]
"""The position and velocity of a joint now."""


class Line(Protocol):
    """The path that the joints share."""

    @property
    def over(self) -> bool:
        """Whether it has ended, at the goal or braked."""
        ...

    def brake(self) -> None:
        """Come to rest on the path."""
        ...


class JointRun:
    """One motion, which owns its joints while it runs; if one fails, all brake along the line."""

    def __init__(
        self, name: str, line: Line, goals: Mapping[Axis, float], follows: Mapping[Axis, Follow]
    ) -> None:
        self._name, self._line, self._goals, self._follows = name, line, goals, follows
        self._ended: list[RcpError] = []

    def end(self, reason: RcpError) -> None:
        """End the motion: the joints brake, and `run` raises the reason."""
        self._ended.append(reason)

    async def run(self, watch: Callable[[], None]) -> None:
        """Move, and wait for arrival; `watch` is called often, and may raise.

        :raises RcpError: a joint has failed, or `end` was called; the joints have braked.
        """
        for axis in self._goals:
            axis.owner = self._name
        try:
            await self._go(watch)
            await self._arrive()
        except (asyncio.CancelledError, RcpError) as error:
            await self._halt(error)
            raise
        finally:
            for axis in self._goals:
                axis.owner = axis.ended = None

    async def _go(self, watch: Callable[[], None]) -> None:
        for axis, goal in self._goals.items():
            axis.ended = self.end
            axis.command("position", goal, self._follows[axis])
        while not self._line.over:
            watch()
            await asyncio.sleep(_POLL_PERIOD)
            if self._ended:
                raise self._ended[0]

    async def _arrive(self) -> None:
        """Wait until every drive reports that it has reached its goal."""
        waits = together(
            drive_to(axis, m.Move(position=goal), _silently) for axis, goal in self._goals.items()
        )
        arriving = asyncio.ensure_future(waits)
        try:
            while not arriving.done():
                await asyncio.wait((arriving,), timeout=_POLL_PERIOD)
                if self._ended:
                    raise self._ended[0]
            arriving.result()
        finally:
            arriving.cancel()
            with anyio.CancelScope(shield=True):
                await asyncio.wait((arriving,))

    async def _halt(self, why: BaseException) -> None:
        """Brake along the shared line, and wait until each joint is at rest.

        :raises RcpError: the move was cancelled, and a joint is not confirmed to be at rest.
        """
        axes = self._goals.keys()
        if fenced_off():  # the stop controls the joints now: this move sends nothing more
            for axis in axes:
                axis.ended = None
            return
        settled: list[BaseException | None] = []
        with anyio.CancelScope(shield=True):
            self._line.brake()
            for axis in axes:
                axis.ended, axis.leaving = None, True
            while not self._line.over and any(axis.mode == "position" for axis in axes):  # noqa: ASYNC110
                await asyncio.sleep(_POLL_PERIOD)
            settled = await asyncio.gather(
                *(_settle(axis, why) for axis in axes), return_exceptions=True
            )
        if isinstance(why, asyncio.CancelledError):
            for error in settled:
                if isinstance(error, BaseException):
                    raise error


async def _settle(axis: Axis, why: BaseException) -> None:
    try:
        if axis.mode == "position" and why is not axis.gone:
            await rested(axis)  # and it holds the position where it came to rest
        else:
            await abandon(axis, why)
    except RcpError:
        if axis.status.energised is not False:
            axis.stop()
        raise
    finally:
        axis.leaving = False


def _silently(*_: Any, **__: Any) -> None:
    """Ignore progress: the group reports it."""
