"""The hub's end of one link, as what carries a client's session."""

from __future__ import annotations

import asyncio
import secrets
from typing import Any

import zenoh

from rcp_client.carrier import Carrier, Lost, Received
from rcp_client.messages import Codec
from rcp_zenoh.keys import LinkKeys
from rcp_zenoh.pipe import Pipe
from rcp_zenoh.session import on_loop

__all__ = ["FleetLink"]


class FleetLink(Carrier):
    """One link with a gateway; its token tells the gateway that it begins, and that it ends."""

    def __init__(
        self,
        session: zenoh.Session,
        place: tuple[str, str, str],
        codec: Codec,
        received: Received,
        lost: Lost,
    ) -> None:
        keys = LinkKeys.of(*place, secrets.token_hex(8))
        self._codec, self._received, self._lost = codec, received, lost
        self.segment_size: int | None = None
        self._why = "the link was closed"
        self._waiting: list[bytes] = []
        """Messages for which the window has no room yet."""
        self._pipe = Pipe(session, keys.up, self._drain, self._ended)
        loop = asyncio.get_running_loop()
        self._messages = session.declare_subscriber(keys.down, on_loop(loop, self._take))
        self._token = session.liveliness().declare_token(keys.token)

    @property
    def closed(self) -> bool:
        """Whether it has ended."""
        return self._pipe.closed

    @property
    def why(self) -> str:
        """Why it has ended."""
        return self._why

    def send(self, envelope: dict[str, Any]) -> None:
        """Send an envelope, or keep it until there is room."""
        if not self.closed:
            self._waiting.append(self._codec.encode(envelope))
            self._drain()

    def _drain(self) -> None:
        while self._waiting and self._pipe.writable:
            self._pipe.send(self._waiting.pop(0))

    def _take(self, sample: zenoh.Sample) -> None:
        data = self._pipe.receive(sample)
        if data is not None:
            self._received(self._codec.decode(data), data)

    def close(self, why: str = "the hub closed the link") -> None:
        """End the link."""
        self._pipe.end(why)

    def _ended(self, why: str) -> None:
        self._why = why
        self._waiting.clear()
        self._messages.undeclare()
        self._token.undeclare()
        self._lost(self)
