"""Message rates: requested from the vehicle, and restored when no longer needed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rcp_kernel.errors import RcpError
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.vehicle import Vehicle

__all__ = ["FASTEST", "Intervals"]

_SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 511, 512
FASTEST = 50.0  # Hz, for subscribers without a rate limit


class Intervals:
    """The requested rates of one vehicle, by message."""

    def __init__(self, vehicle: Vehicle, commands: Commands, base: dict[str, float]) -> None:
        self._vehicle, self._commands, self._base = vehicle, commands, base
        self._wishes: dict[str, list[float]] = {}
        self._requested: dict[str, float] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._closed = False
        self.refused: set[str] = set()
        """Messages that the vehicle does not send."""

    def want(self, message: str, rate: float) -> Callable[[], None]:
        """Request a message at a rate; return a function that withdraws the request."""
        wishes = self._wishes.setdefault(message, [])
        wishes.append(rate)
        self._adjust(message)

        def unwant() -> None:
            wishes.remove(rate)
            if not wishes and self._wishes.get(message) is wishes:
                del self._wishes[message]
            self._adjust(message)

        return unwant

    def _rate(self, message: str) -> float:
        """Return the requested rate; 0 for the vehicle's default."""
        return max([*self._wishes.get(message, ()), self._base.get(message, 0.0)])

    def begin(self) -> None:
        """Request all rates, at the start and after a reboot of the vehicle."""
        self._requested.clear()
        self.refused.clear()
        for message in {*self._base, *self._wishes}:
            self._adjust(message)

    def _adjust(self, message: str) -> None:
        """Send the rate to the vehicle, unless this is already in progress."""
        settled = self._requested.get(message, 0.0) == self._rate(message)
        if self._closed or settled or message in self._tasks:
            return
        task = asyncio.get_running_loop().create_task(self._request(message))
        self._tasks[message] = task
        task.add_done_callback(lambda _: self._tasks.pop(message, None))

    async def _request(self, message: str) -> None:
        number = self._vehicle.dialect.by_name[message].id
        while not self._vehicle.lost:
            rate = self._rate(message)
            if self._requested.get(message, 0.0) == rate:
                return
            microseconds = round(1e6 / rate) if rate else 0
            command = Command(_SET_MESSAGE_INTERVAL, (number, microseconds, 0.0, 0.0))
            try:
                await self._commands.send(command, f"{message} at {rate:g} Hz")
            except RcpError:
                self.refused.add(message)
            self._requested[message] = rate

    async def request(self, message: str) -> None:
        """Request one message now.

        :raises DeviceRejected: the vehicle does not have it.
        """
        number = self._vehicle.dialect.by_name[message].id
        await self._commands.send(
            Command(_REQUEST_MESSAGE, (number, 0.0, 0.0, 0.0)), f"request for {message}"
        )

    async def close(self) -> None:
        """Withdraw all requests, without waiting for confirmation."""
        self._closed = True
        for task in list(self._tasks.values()):
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        for message in self._requested:
            number = self._vehicle.dialect.by_name[message].id
            self._commands.send_once(Command(_SET_MESSAGE_INTERVAL, (number, 0.0, 0.0, 0.0)))
