"""Who talks on a bus: frames by identifier with their rates, and identifiers that nothing takes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.messages import BusState, Count, Hertz, Identifier, Load
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host

if TYPE_CHECKING:
    import can

__all__ = ["Talker", "Traffic", "TrafficPart"]

_MOST = 256  # talkers in one value
_TIMEOUT = 5.0  # s that a read may take beyond one period


class Talker(Struct, frozen=True, kw_only=True):
    """The frames with one identifier, in one period."""

    id: Identifier
    extended: bool = False
    sent: bool = False
    """Sent by the gateway, not received."""
    known: bool
    """Whether a motor, device or node of the configuration takes it, or the gateway sent it."""
    takers: list[str] = []
    """Those of the configuration that take it, by name."""
    rate: Hertz
    frames: Count
    load: Load | None
    """Its part of the load; None without a bit rate."""


class Traffic(Struct, frozen=True, kw_only=True):
    """The traffic of one period."""

    controller: BusState
    """State and error counters of the controller, as far as the adapter reports them."""
    load: Load | None
    """Fraction of the time that the bus was busy; None without a bit rate."""
    rate: Hertz
    error_frames: Count
    talkers: list[Talker]
    """The most frequent first."""
    left_out: Count = 0
    """How many identifiers did not fit into `talkers`."""
    unknown: Count
    """How many identifiers nothing of the configuration takes."""


class TrafficPart(Part):
    """The analyser of one bus; frames are counted only while somebody asks."""

    def __init__(self, bus: Bus, host: Host) -> None:
        self._bus, self._host = bus, host
        self._name = f"sensor/can/{bus.name}/traffic"

    def resources(self) -> list[Resource]:
        """List its one resource."""
        period = self._bus.config.statistics
        return [
            Resource(
                name=self._name,
                description=f"Frames on CAN bus '{self._bus.name}' by identifier, and its load.",
                value=Traffic,
                timeout=period + _TIMEOUT,
                deadline=3 * period,
                history=1,
            )
        ]

    async def read(self, name: str) -> Any:
        """Count for one period of `statistics`."""
        if name != self._name:
            return await super().read(name)
        with _Counter(self._bus).counting() as counter:
            await asyncio.sleep(self._bus.config.statistics)
            return counter.take()

    def watch(self, name: str) -> AbstractContextManager[object]:
        """Publish once in each period while a client subscribes."""
        return self._watched() if name == self._name else super().watch(name)

    @contextmanager
    def _watched(self) -> Generator[None]:
        with _Counter(self._bus).counting() as counter:
            counting = asyncio.create_task(self._publish(counter), name=f"can {self._bus.name}")
            try:
                yield
            finally:
                counting.cancel()

    async def _publish(self, counter: _Counter) -> None:
        while True:
            await asyncio.sleep(self._bus.config.statistics)
            self._host.publish(self._name, counter.take())


class _Counter:
    """Counts the frames of a bus since the last `take`."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._began, self._errors = time.monotonic(), 0
        self._counts: dict[tuple[int, bool, bool], tuple[int, float]] = {}

    @contextmanager
    def counting(self) -> Generator[_Counter]:
        """Count while entered."""
        self._bus.taps.append(self._tap)
        try:
            yield self
        finally:
            self._bus.taps.remove(self._tap)

    def _tap(self, message: can.Message) -> None:
        if message.is_error_frame:
            self._errors += 1
            return
        key = message.arbitration_id, message.is_extended_id, not message.is_rx
        frames, busy = self._counts.get(key, (0, 0.0))
        self._counts[key] = frames + 1, busy + self._bus.duration(message)

    def take(self) -> Traffic:
        """Return what was counted, and begin anew."""
        now = time.monotonic()
        period, counts, errors = now - self._began, self._counts, self._errors
        self._began, self._counts, self._errors = now, {}, 0
        metered = self._bus.config.bitrate is not None
        talkers = [
            Talker(
                id=identifier,
                extended=extended,
                sent=sent,
                known=sent or self._bus.routing.takes(identifier, extended=extended),
                takers=[] if sent else self._bus.routing.takers(identifier, extended=extended),
                rate=frames / period,
                frames=frames,
                load=busy / period if metered else None,
            )
            for (identifier, extended, sent), (frames, busy) in counts.items()
        ]
        talkers.sort(key=lambda talker: (-talker.frames, talker.id))
        return Traffic(
            controller=self._bus.reported_state,
            load=sum(busy for _, busy in counts.values()) / period if metered else None,
            rate=sum(frames for frames, _ in counts.values()) / period,
            error_frames=errors,
            talkers=talkers[:_MOST],
            left_out=max(0, len(talkers) - _MOST),
            unknown=sum(not talker.known for talker in talkers),
        )
