"""A Zenoh session for an event loop: opened in a thread, its callbacks brought to the loop."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import cache
from typing import Any, Literal

import structlog
import zenoh
from zenoh.handlers import Callback

from rcp_kernel.errors import NotReady
from rcp_zenoh.tls import TlsConfig

__all__ = ["Intake", "configuration", "on_loop", "opened"]

log = structlog.get_logger("rcp.zenoh")
_ROOM = 67_108_864  # bytes that wait for the event loop
_EACH = 1024  # bytes that a sample takes beside its payload
_PAUSE = 1.0  # s between two attempts to reach a router
_SESSIONS, _PENDING = 20_000, 2_000  # of a router: robots, and those that come at once
_QUEUES = {"real_time": 16, "interactive_high": 16, "data": 8, "background": 16}
"""Batches of 64 KiB by priority: twice what the windows of a link let through."""


def configuration(
    mode: Literal["client", "router"],
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    silence: float = 3.0,
    tls: TlsConfig | None = None,
    access: Mapping[str, Any] | None = None,
) -> zenoh.Config:
    """Make a configuration that finds nobody by itself: the endpoints are all there is.

    A connection ends after a `silence` of so many seconds. `access` are the rules of a router.
    """
    config = zenoh.Config()
    for key, value in (
        ("mode", mode),
        ("listen/endpoints", list(listen)),
        ("connect/endpoints", list(connect)),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),  # a proxy or another machine has none
        ("transport/link/tx/lease", round(silence * 1000)),
        # It would save copies on one machine, where it allows for no more than 350 sessions.
        ("transport/shared_memory/enabled", False),
        ("transport/unicast/max_sessions", _SESSIONS),
        ("transport/unicast/accept_pending", _PENDING),
        *((f"transport/link/tx/queue/size/{name}", size) for name, size in _QUEUES.items()),
        *((f"transport/link/tls/{name}", value) for name, value in _settings(tls).items()),
        *(() if access is None else (("access_control", access),)),
    ):
        config.insert_json5(key, json.dumps(value))
    return config


def _settings(tls: TlsConfig | None) -> dict[str, object]:
    return {} if tls is None else tls.settings


_LOG = (
    "zenoh_link_tls=warn,zenoh_link_commons=warn,"  # whose certificate it refuses
    # That a message is forbidden; which one would be a line for each that is not, too.
    "zenoh::net::routing::interceptor=trace,zenoh::net::routing::interceptor::access_control=warn"
)


@cache
def _log() -> None:
    """Let Zenoh write on stdout what `RUST_LOG` says: by default, what it refuses."""
    zenoh.init_log_from_env_or(_LOG)


@asynccontextmanager
async def opened(config: zenoh.Config, *, patient: bool) -> AsyncGenerator[zenoh.Session]:
    """Open a session, and close it at the end.

    :raises NotReady: it cannot be opened, and the caller is not `patient`.
    """
    _log()
    while True:
        try:
            session = await asyncio.to_thread(zenoh.open, config)
            break
        except zenoh.ZError as error:
            if not patient:
                raise NotReady(f"Zenoh: {error}") from error
            log.debug("zenoh_router_unreachable", reason=str(error))
        await asyncio.sleep(_PAUSE)
    try:
        yield session
    finally:
        await asyncio.to_thread(session.close)


def on_loop(
    loop: asyncio.AbstractEventLoop, handle: Callable[[zenoh.Sample], object]
) -> Callback[zenoh.Sample]:
    """Return a callback that passes samples to the event loop.

    It runs in Zenoh's receiving thread: a plain function would get a thread of its own for each
    subscriber.
    """

    def receive(sample: Any) -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(handle, sample)

    return Callback(receive, indirect=False)


class Intake:
    """Samples on their way to the event loop: what is more than it can take is dropped, stops never.

    Zenoh's thread must not be blocked: it receives the stops as well. A link notices what it lacks by
    the numbers of its messages.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        handle: Callable[[zenoh.Sample], object],
        room: int = _ROOM,
    ) -> None:
        """`room` is the number of bytes that may wait."""
        self._loop, self._handle, self._room = loop, handle, room
        self._lock = threading.Lock()
        self._waiting = self._untold = 0
        self.dropped = 0
        """Samples that found no room."""

    def callback(self) -> Callback[zenoh.Sample]:
        """Return what a subscriber calls in Zenoh's receiving thread."""
        return Callback(self.receive, indirect=False)

    def receive(self, sample: Any) -> None:
        """Take a sample, in any thread."""
        if self._loop.is_closed():
            return
        size = _EACH + len(sample.payload)
        with self._lock:
            if self._waiting + size > self._room and sample.priority != zenoh.Priority.REAL_TIME:
                self.dropped += 1
                return
            self._waiting += size
        self._loop.call_soon_threadsafe(self._pass, sample, size)

    def _pass(self, sample: zenoh.Sample, size: int) -> None:
        with self._lock:
            self._waiting -= size
            done = not self._waiting
        if done and self.dropped != self._untold:
            self._untold = self.dropped
            log.warning("zenoh_messages_dropped", dropped=self.dropped)
        self._handle(sample)
