"""The requests of one connection that the device has not answered yet."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Generic, TypeVar

import structlog

from rcp_protocol.errors import AdapterUnavailable, DeviceTimeout, RcpError

__all__ = ["Request", "Requests"]

M = TypeVar("M")
log = structlog.get_logger("rcp.links")
_MOST_LATE = 1000  # requests of which a late answer is still taken


class Request(Generic[M]):
    """One request that was sent."""

    def __init__(self, effect: Callable[[M], None] | None) -> None:
        self.effect = effect
        self.answer: asyncio.Future[M] = asyncio.get_running_loop().create_future()

    def take(self, message: M) -> None:
        """Note the answer, whoever still waits for it, and whether or not the effect fails."""
        if not self.answer.done():
            self.answer.set_result(message)
        if self.effect is None:
            return
        try:
            self.effect(message)  # who waits goes on after it, in a later turn of the loop
        except (Exception, asyncio.CancelledError):
            log.exception("effect failed")

    def lose(self, reason: str) -> None:
        """Note that no answer will come."""
        if self.answer.done():
            return
        self.answer.set_exception(self._lost(reason))
        self.answer.exception()  # retrieved: perhaps nobody waits any more

    def _lost(self, reason: str) -> RcpError:
        if self.effect is None:
            return AdapterUnavailable(f"no answer: {reason}")
        # Not a refusal: it may have been carried out.
        return DeviceTimeout(f"it is unknown whether the device has done it: {reason}")


class Requests(Generic[M]):
    """The requests under way, by number."""

    def __init__(self) -> None:
        self._open: dict[int, Request[M]] = {}
        self._late: dict[int, Request[M]] = {}
        """Those that nobody waits for any more, and whose effect is still to be known."""

    def add(self, number: int, request: Request[M]) -> None:
        """Expect an answer under a number."""
        self._open[number] = request

    def leave(self, number: int) -> None:
        """Wait no longer; a late answer still tells its effect, but for the oldest of very many."""
        request = self._open.pop(number, None)
        if request is None or request.effect is None:
            return
        self._late[number] = request
        if len(self._late) > _MOST_LATE:
            del self._late[next(iter(self._late))]

    def take(self, number: int, message: M) -> None:
        """Pass an answer on; one that nobody asked for is dropped."""
        request = self._open.pop(number, None) or self._late.pop(number, None)
        if request is not None:
            request.take(message)

    def lose(self, reason: str) -> None:
        """End all of them: the connection on which the answers would come is gone."""
        lost = list(self._open.values())
        self._open.clear()
        self._late.clear()
        for request in lost:
            request.lose(reason)
