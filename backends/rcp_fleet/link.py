"""The hub's end of one link, as what carries a client's session."""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import zenoh

from rcp_client.carrier import Carrier, Lost, Received
from rcp_client.messages import Codec
from rcp_fleet.link_names import LinkNames
from rcp_fleet.values import RobotFeed, undecoded_update
from rcp_zenoh.budget import Allowance
from rcp_zenoh.declared_keys import DeclaredKeys
from rcp_zenoh.inbox import received
from rcp_zenoh.keys import LinkKeys
from rcp_zenoh.lane import Priority
from rcp_zenoh.pipe import Pipe
from rcp_zenoh.statistics import LinkStatistics

__all__ = ["FleetLink", "FleetLinks"]

_LONGEST = 67_108_864  # bytes of a message that a gateway may make this hub keep


class FleetLink(Carrier):
    """One link with a gateway; its token tells the gateway that it begins, and that it ends."""

    def __init__(
        self,
        session: zenoh.Session,
        key: zenoh.KeyExpr,
        token: str,
        silence: float,
        statistics: LinkStatistics,
        feed_of: Callable[[str | None], RobotFeed | None],
        codec: Codec,
        received: Received,
        lost: Lost,
    ) -> None:
        self._codec, self._received, self._lost = codec, received, lost
        self._statistics, self._feed_of = statistics, feed_of
        self.segment_size: int | None = None
        self.longest = _LONGEST
        self._why = "the link was closed"
        self._waiting: deque[bytes] = deque()
        """Messages for which the window has no room yet."""
        self._pipe = Pipe(session, key, silence, self, Allowance(), self._note)
        self._token = session.liveliness().declare_token(token)
        statistics.opened(self._pipe)

    @property
    def closed(self) -> bool:
        """Whether it has ended."""
        return self._pipe.closed

    @property
    def why(self) -> str:
        """Why it has ended."""
        return self._why

    def send(self, envelope: dict[str, Any]) -> None:
        """Send an envelope, or keep it until there is room; an e-stop never waits."""
        if self.closed:
            return
        data = self._codec.encode(envelope)
        if envelope.get("type") == "execute" and envelope.get("path") == "/system/estop":
            self._pipe.send(data, Priority.STOP)
            return
        self._waiting.append(data)
        self.drained()

    def drained(self) -> None:
        """Send what waits for room."""
        while self._waiting and self._pipe.writable(Priority.CONTROL):
            self._pipe.send(self._waiting.popleft(), Priority.CONTROL)

    def take(self, sample: zenoh.Sample) -> None:
        """Handle what the gateway sent."""
        message = self._pipe.receive(sample)
        if message is None:
            return
        if message.data is None:
            self.close(f"the gateway sent a message of {message.size} bytes")
            return
        data = message.data
        if (update := undecoded_update(data)) is not None:
            feed = self._feed_of(update.id)
            if feed is not None:  # nearly always: the rest of the session is left out of it
                feed.take(update)
                return
        self._received(self._codec.decode(data), data)

    def close(self, why: str = "the hub closed the link") -> None:
        """End the link."""
        self._pipe.end(why)

    def ended(self, why: str) -> None:
        """Report the end."""
        self._why = why
        self._statistics.ended(self._pipe, why)
        self._waiting.clear()
        self._token.undeclare()
        self._lost(self)

    def _note(self) -> None:
        self._statistics.note(self._pipe)


class FleetLinks:
    """The links of a hub: one subscriber for what all gateways say to it."""

    def __init__(
        self, session: zenoh.Session, names: LinkNames, tenant: str, hub: str, silence: float
    ) -> None:
        self._session, self._tenant, self._hub = session, tenant, hub
        self._names, self._silence = names, silence
        self._declared = DeclaredKeys(session)
        self._links: dict[str, FleetLink] = {}
        """By the key on which the gateway speaks."""

    @asynccontextmanager
    async def receiving(self) -> AsyncGenerator[None]:
        """Receive for all links while entered."""
        every = LinkKeys.of(self._tenant, "*", self._hub, "*").down
        async with received(partial(self._session.declare_subscriber, every), self._take):
            yield

    def _take(self, sample: zenoh.Sample) -> None:
        link = self._links.get(str(sample.key_expr))
        if link is not None:
            link.take(sample)

    def open(
        self,
        gateway: str,
        statistics: LinkStatistics,
        feed_of: Callable[[str | None], RobotFeed | None],
        codec: Codec,
        received: Received,
        lost: Lost,
    ) -> FleetLink:
        """Open a link with a gateway."""
        name = self._names.take(gateway)
        keys = LinkKeys.of(self._tenant, gateway, self._hub, name)

        # A key that Zenoh knows has a route; for any other it looks through those of all gateways.
        self._declared.of(keys.down)
        up = self._declared.of(keys.up)

        def ended(link: Carrier) -> None:
            del self._links[keys.down]
            self._names.release(gateway, name)
            lost(link)

        link = self._links[keys.down] = FleetLink(
            self._session,
            up,
            keys.token,
            self._silence,
            statistics,
            feed_of,
            codec,
            received,
            ended,
        )
        return link
