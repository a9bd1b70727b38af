"""Values that no sample at hand answers: read with a call of the backend, or the next published."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Coroutine
from time import perf_counter
from typing import Any

from rcp_kernel.clock import now
from rcp_kernel.contract.internal_errors import attribute_error
from rcp_kernel.errors import AdapterUnavailable, RcpError, UnsupportedOperation
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Backend, Publication, has_watch
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Sample
from rcp_streams.frames import FrameConverter

__all__ = ["ValueFetcher"]


class ValueFetcher:
    """Reads values from backends."""

    def __init__(self, registry: Registry, frames: FrameConverter) -> None:
        self._registry = registry
        self._frames = frames

    def fetch(
        self, session: Session, frame: str | None, entry: Entry
    ) -> Coroutine[Any, Any, Sample]:
        """Read a value, in a frame if its robot has a gateway that converts.

        If the backend can only publish, the value is the next sample after this call, not after the
        first step of the coroutine.
        """
        if frame is None or not entry.owner.has_gateways:
            return self._fetch(entry, entry.latest)
        return self._fetch_in_frame(session, entry, frame)

    async def _fetch(self, entry: Entry, seen: Sample | None) -> Sample:
        """Read a value, or wait for a later sample than the one `seen`."""
        backend = entry.unit.usable_backend
        if backend is None:
            raise entry.unit.unavailable()
        started = perf_counter()
        try:
            value = await _attributed(entry, backend.read(entry.name))
        except UnsupportedOperation:
            # A backend that has just opened may have declared the path anew.
            entry = self._registry.entries.get(entry.path, entry)
            if (sample := entry.latest) is not None and sample is not seen:
                return sample
            return await _first(entry, backend)
        entry.owner.latency = perf_counter() - started
        if isinstance(value, Publication):
            return entry.publish(value.value, value.timestamp)
        return entry.publish(value, None)

    async def _fetch_in_frame(self, session: Session, entry: Entry, frame: str) -> Sample:
        """Read a value in a frame from the robot's own gateway, which knows its transforms."""
        self._frames.view(session, entry, frame).check()  # there, the hub's own rights may count
        backend = entry.unit.usable_backend
        if backend is None:
            raise entry.unit.unavailable()
        value: Any = await _attributed(entry, backend.read_in_frame(entry.name, frame))
        return Sample(entry, value, value.timestamp, now(), value.seq, "encoded")


async def _attributed(entry: Entry, reading: Awaitable[Any]) -> Any:
    """Read from a backend, and name it in its errors."""
    try:
        return await reading
    except RcpError as error:
        error.origin = error.origin or entry.owner.name
        raise
    except Exception as error:
        raise attribute_error(error, entry.owner.name, entry.path) from error


class _Waiter:
    def __init__(self) -> None:
        self.arrived: asyncio.Future[Sample] = asyncio.get_running_loop().create_future()

    def offer(self, sample: Sample) -> None:
        if not self.arrived.done():
            self.arrived.set_result(sample)


async def _first(entry: Entry, backend: Backend) -> Sample:
    """Watch until the first sample arrives; sources that publish unasked must have published."""
    if not has_watch(backend):
        raise AdapterUnavailable(
            f"{entry.path} has no value yet",
            path=entry.path,
            origin=entry.owner.name,
            remedy="Wait until the robot publishes it, or subscribe to it.",
        )
    waiter = _Waiter()
    entry.listeners.append(waiter)
    try:
        async with backend.watch(entry.name, None):
            return await waiter.arrived
    finally:
        if waiter in entry.listeners:
            entry.listeners.remove(waiter)
