"""The operator's end of a roll-out: one robot after the other, until one fails."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Iterable

from rcp_client import Client
from rcp_configuration.seal import SealError, seal
from rcp_configuration.service import ConfigurationState
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeadlineExceeded,
    DeviceTimeout,
    Failed,
    PreconditionFailed,
    RcpError,
    UnknownPath,
)

__all__ = ["RollOut", "RollOutError"]

_MARGIN = 30.0  # s for a robot to return after its roll-back
_ANSWER = 15.0  # s for one answer of a robot
_PAUSE = 0.5  # s between two attempts to confirm
_UNKNOWN = (AdapterUnavailable, DeadlineExceeded, DeviceTimeout, Failed)
"""After which a proposal may have arrived: its reply is lost if it cuts the hub off."""


class RollOutError(Exception):
    """A robot does not have the configuration; the text says why."""


class RollOut:
    """One file for some robots, over a hub."""

    def __init__(
        self,
        client: Client,
        data: bytes,
        *,
        seconds: float,
        restart: bool,
        say: Callable[[str], object],
    ) -> None:
        self._client, self._data, self._say = client, data, say
        self._seconds, self._restart = seconds, restart
        self._digest = hashlib.sha256(data).hexdigest()

    async def run(self, robots: Iterable[str]) -> None:
        """Give all of them the file.

        :raises RollOutError: one refused it or rolled it back; those after it were not asked.
        """
        for robot in robots:
            try:
                self._say(f"{robot}: {await self._to(robot)}")
            except UnknownPath:
                raise RollOutError(
                    f"{robot}: it is not at this hub, lacks the feature `configuration`, or gives you no "
                    "right to it"
                ) from None
            except (RcpError, SealError) as error:
                raise RollOutError(f"{robot}: {error}") from None

    async def _to(self, robot: str) -> str:
        path = f"/service/{robot}/gateway/configuration"
        before = await self._client.read(path, fresh=True, type=ConfigurationState)
        if before.digest == self._digest and before.phase in (None, "confirmed", "rolled_back"):
            return "has it already"
        proposal = {
            "propose": seal(self._data, before.key),
            "seconds": self._seconds,
            "restart": self._restart,
        }
        try:
            await self._client.execute(path, proposal, deadline=_ANSWER)
        except _UNKNOWN as error:
            self._say(f"{robot}: no answer yet ({error})")
        except PreconditionFailed:
            if not await self._has_arrived(path, before):
                raise
        await self._confirm(path)
        return "confirmed"

    async def _has_arrived(self, path: str, before: ConfigurationState) -> bool:
        """Return whether the robot has the proposal: one whose reply was lost is sent again."""
        now = await self._client.read(path, fresh=True, type=ConfigurationState)
        if now.proposed != self._digest:
            return False
        return now.phase != "rolled_back" or now.since != before.since

    async def _confirm(self, path: str) -> None:
        """Confirm until the robot has agreed or rolled back.

        :raises RcpError: it has rolled back, or will.
        """
        loop = asyncio.get_running_loop()
        end, why = loop.time() + self._seconds + _MARGIN, "no answer"
        while loop.time() < end:
            try:
                await self._client.execute(path, {"confirm": self._digest}, deadline=_ANSWER)
            except PreconditionFailed:
                raise
            except RcpError as error:
                why = str(error)
            else:
                return
            await asyncio.sleep(_PAUSE)
        raise DeadlineExceeded(f"not confirmed, so it rolls back by itself: {why}")
