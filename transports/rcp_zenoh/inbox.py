"""What a subscriber receives, brought to the event loop in batches."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Protocol

import structlog
import zenoh
from zenoh.handlers import FifoChannel, Handler

__all__ = ["Subscribe", "received"]

log = structlog.get_logger("rcp.zenoh")
_ROOM = 16_384  # samples that wait for the loop; with more, Zenoh stops reading
_PERIOD = 0.001  # s between two times that the loop is woken: what arrives meanwhile costs none
_LONG_PERIOD = 0.003  # s, when much arrives: then the loop looks by itself, and no thread wakes it
_MUCH = 7  # samples in `_PERIOD`
_BATCH = 128  # samples handled before others have their turn


class Subscribe(Protocol):
    """The declaration of a subscriber."""

    def __call__(
        self, handler: FifoChannel[zenoh.Sample], /
    ) -> zenoh.Subscriber[Handler[zenoh.Sample]]:
        """Declare it with this handler."""
        ...


class _Inbox:
    """A channel, and the thread that wakes the event loop when something is in it after a rest.

    Zenoh's own thread would need the interpreter for each call of a callback, and wait 5 ms for it
    while the loop is busy: meanwhile, the queues of the router fill, and drop.
    """

    def __init__(
        self, handler: Handler[zenoh.Sample], handle: Callable[[zenoh.Sample], object]
    ) -> None:
        self._handler, self._handle = handler, handle
        self._loop = asyncio.get_running_loop()
        self._empty = threading.Semaphore(0)
        self._count, self._since = 0, float("-inf")
        """Samples handled since the channel was last found empty, and when that was."""
        self.thread = threading.Thread(target=self._wait, name="zenoh inbox", daemon=True)
        self.thread.start()

    def _wait(self) -> None:
        last = float("-inf")
        try:
            while True:
                first = self._handler.recv()
                time.sleep(max(0.0, last + _PERIOD - time.monotonic()))
                last = time.monotonic()
                self._loop.call_soon_threadsafe(self._drain, first)
                self._empty.acquire()
        except zenoh.ZError:  # it has been undeclared
            return

    def _drain(self, sample: zenoh.Sample | None = None) -> None:
        for _ in range(_BATCH):
            if sample is not None:
                self._count += 1
                self._pass(sample)
            sample = self._next()
            if sample is None:
                self._rest()
                return
        self._loop.call_soon(self._drain, sample)

    def _rest(self) -> None:
        """Look again soon if much has arrived; otherwise let the thread wait for the next sample."""
        moment = time.monotonic()
        much = self._count * _PERIOD > _MUCH * (moment - self._since)
        self._count, self._since = 0, moment
        if much:
            self._loop.call_later(_LONG_PERIOD, self._drain)
        else:
            self._empty.release()

    def _pass(self, sample: zenoh.Sample) -> None:
        try:
            self._handle(sample)
        except Exception:
            log.exception("zenoh_sample_failed")

    def _next(self) -> zenoh.Sample | None:
        try:
            return self._handler.try_recv()
        except zenoh.ZError:  # it has been undeclared
            return None


@asynccontextmanager
async def received(
    subscribe: Subscribe, handle: Callable[[zenoh.Sample], object]
) -> AsyncGenerator[None]:
    """Let the event loop handle, in their order, the samples of a subscriber while entered."""
    subscriber = subscribe(FifoChannel(_ROOM))
    inbox = _Inbox(subscriber.handler, handle)
    try:
        yield
    finally:
        # The loop goes on meanwhile: Zenoh's thread may be waiting for room.
        await asyncio.to_thread(subscriber.undeclare)
        await asyncio.to_thread(inbox.thread.join)
