"""Release of final replies: features may delay them until their record is stored."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Protocol

from rcp_kernel.config.settings import Settings
from rcp_kernel.features import Durability
from rcp_kernel.sessions.session import Answer
from rcp_kernel.sessions.substitutes import unrecorded
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Reply, Request

__all__ = ["Demand", "ReplyGate"]


class Demand(Durability, Protocol):
    """A `Durability`, and whether all its events were recorded."""

    @property
    def lost(self) -> int:
        """Number of events that were never recorded."""
        ...


class ReplyGate:
    """Passes replies through the features that delay them, or else immediately."""

    def __init__(self, settings: Settings, loop: asyncio.AbstractEventLoop) -> None:
        self.demands: list[Demand] = []
        self._settings = settings
        self._loop = loop

    @property
    def lost(self) -> int:
        """Number of unrecorded events; if it has increased, the last one is unconfirmed."""
        lost = 0
        for demand in self.demands:
            lost += demand.lost
        return lost

    def confirmed(self, reply: Reply, lost: int) -> Reply:
        """Return a reply, or one that confirms nothing if something is unrecorded since `lost`."""
        if reply.error is not None or self.lost == lost:
            return reply
        return unrecorded(reply, "could not be written")

    def when_stored(self, answer: Answer, request: Request, entry: Entry | None = None) -> Answer:
        """Return a callback that passes on the replies to a request when they may be sent."""
        if not self.demands:
            return answer
        limit = request.deadline or self._settings.limits.deadline
        if entry is not None:
            limit = min(limit, entry.resource.timeout or limit)
        until = self._loop.time() + limit
        for demand in self.demands:
            answer = partial(demand.send_when_stored, answer, until)
        return answer

    def follower(self, answer: Answer) -> Answer:
        """Return a callback that passes on the replies to a further follower of a command."""
        until = self._loop.time() + self._settings.limits.deadline
        for demand in self.demands:
            answer = partial(demand.send_when_stored, answer, until)
        return answer

    def estop_when_stored(self, answer: Answer) -> Answer:
        """Return a callback that passes on the reply to an e-stop, after a short time at most."""
        for demand in self.demands:
            answer = partial(demand.send_estop_when_stored, answer)
        return answer
