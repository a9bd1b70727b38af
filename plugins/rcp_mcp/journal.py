"""The past events of a session's streams, with which its client resumes after a disconnect.

The SDK identifies streams by their requests only, which are not unique across sessions: a shared
journal would give one client the events of another.
"""

from __future__ import annotations

import secrets
import weakref
from collections import deque
from typing import Any, NamedTuple

from mcp.server.streamable_http import EventCallback, EventId, EventMessage, EventStore, StreamId
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from mcp.types import JSONRPCMessage

from rcp_gateway.api import Backlog, Outbound

__all__ = ["Journal", "Manager"]

_EVENTS = 256
_BYTES = 2_000_000


class _Event(NamedTuple):
    id: EventId
    stream: StreamId
    message: JSONRPCMessage | None
    size: int


class Journal(EventStore):
    """The last events of one session, in memory."""

    def __init__(self, backlog: Backlog) -> None:
        self._events: deque[_Event] = deque()
        self._bytes = 0
        self._backlog = backlog
        weakref.finalize(self, backlog.close)  # the SDK discards it without a signal

    async def store_event(self, stream_id: StreamId, message: JSONRPCMessage | None) -> EventId:
        """Store one event, dropping the oldest if necessary; return its id."""
        size = 0 if message is None else len(message.model_dump_json())
        event = _Event(secrets.token_hex(8), stream_id, message, size)
        self._events.append(event)
        self._bytes += size
        self._backlog.set(self._bytes)
        while len(self._events) > _EVENTS or (len(self._events) > 1 and self._has_too_much):
            self._bytes -= self._events.popleft().size
            self._backlog.set(self._bytes)
        return event.id

    @property
    def _has_too_much(self) -> bool:
        return self._bytes > _BYTES or self._backlog.overfull

    async def replay_events_after(
        self, last_event_id: EventId, send_callback: EventCallback
    ) -> StreamId | None:
        """Replay the events after one on its stream; None if they are no longer available."""
        events = list(self._events)
        place = next((n for n, event in enumerate(events) if event.id == last_event_id), None)
        if place is None:
            return None
        stream = events[place].stream
        for event in events[place + 1 :]:
            if event.stream == stream and event.message is not None:
                await send_callback(EventMessage(event.message, event.id))
        return stream


class Manager(StreamableHTTPSessionManager):
    """Gives each session its own journal."""

    def __init__(self, outbound: Outbound, *args: Any, **options: Any) -> None:
        self._outbound = outbound
        super().__init__(*args, **options)

    @property
    def event_store(self) -> EventStore | None:
        """Return a new journal; the SDK reads this once per session."""
        return Journal(self._outbound.open())

    @event_store.setter
    def event_store(self, value: EventStore | None) -> None:
        """Ignore the value that the base class sets."""
