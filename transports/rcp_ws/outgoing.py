"""Sent segmented transfers: one segment per turn, so that a map does not delay a pose."""

from __future__ import annotations

import asyncio
import itertools
from collections import OrderedDict, deque
from collections.abc import Callable

from rcp_kernel.errors import QueueFull, SegmentMissing
from rcp_kernel.values import Encoding
from rcp_ws.segments import Again, cut, digest, frame

__all__ = ["Outgoing"]


class _Transfer:
    __slots__ = ("bodies", "forget", "id", "waiting", "whole")

    def __init__(self, id_: str, data: bytes, size: int) -> None:
        self.id = id_
        self.bodies = cut(data, size)
        self.whole = (len(data), digest(data))
        self.waiting = 0
        """Segments to send, or to send again."""
        self.forget: asyncio.TimerHandle | None = None


class Outgoing:
    """The segmented transfers of one connection.

    `held` is called with the size of all transfers: those being sent, and those kept for
    repetition, which are limited to `room` bytes and dropped first.
    """

    def __init__(
        self,
        encoding: Encoding,
        kept: float,
        room: int,
        loop: asyncio.AbstractEventLoop,
        held: Callable[[int], None],
    ) -> None:
        self.size: int | None = None
        """Maximum length of an unsegmented message; None: no limit."""
        self._encoding = encoding
        self._kept = kept
        self._room = room
        self._loop = loop
        self._held = held
        self._numbers = itertools.count(1)
        self._queue: deque[tuple[_Transfer, int]] = deque()
        self._known: OrderedDict[str, _Transfer] = OrderedDict()
        self._bytes = 0

    @property
    def busy(self) -> bool:
        """Whether segments are queued."""
        return bool(self._queue)

    def sift(self, messages: list[bytes]) -> list[bytes]:
        """Return the unsegmented messages; queue the segments of the others."""
        size = self.size
        assert size is not None
        short: list[bytes] = []
        for data in messages:
            if len(data) <= size:
                short.append(data)
            else:
                self._begin(data, size)
        return short

    def _begin(self, data: bytes, size: int) -> None:
        transfer = _Transfer(f"t-{next(self._numbers)}", data, size)
        self._known[transfer.id] = transfer
        self._bytes += transfer.whole[0]
        self._send(transfer, range(len(transfer.bodies)))
        self._make_room()

    def _send(self, transfer: _Transfer, numbers: range | list[int]) -> None:
        if transfer.forget is not None:
            transfer.forget.cancel()
            transfer.forget = None
        transfer.waiting += len(numbers)
        self._queue.extend((transfer, num) for num in numbers)

    def next(self) -> bytes:
        """Return the next segment; after the last one, the transfer starts to expire."""
        transfer, num = self._queue.popleft()
        transfer.waiting -= 1
        if not transfer.waiting:
            transfer.forget = self._loop.call_later(self._kept, self._drop, transfer)
            self._make_room()
        return frame(transfer.id, num, transfer.bodies, transfer.whole, self._encoding)

    def _make_room(self) -> None:
        """Drop kept transfers, oldest first, until the rest fits."""
        if self._bytes > self._room:
            for transfer in [t for t in self._known.values() if not t.waiting]:
                self._drop(transfer)
                if self._bytes <= self._room:
                    break
        self._held(self._bytes)

    def _drop(self, transfer: _Transfer) -> None:
        if transfer.forget is not None:
            transfer.forget.cancel()
        del self._known[transfer.id]
        self._bytes -= transfer.whole[0]
        self._held(self._bytes)

    def again(self, wish: Again) -> None:
        """Send segments again.

        :raises SegmentMissing: the transfer is no longer available, or has no such segment.
        :raises QueueFull: as many of its segments as it has are already queued.
        """
        transfer = self._known.get(str(wish.id))
        if transfer is None:
            raise SegmentMissing(
                f"the transfer '{wish.id}' is no longer available",
                remedy="Read the value again.",
            )
        total = len(transfer.bodies)
        wanted = sorted(set(wish.resend))
        if any(num >= total for num in wanted):
            raise SegmentMissing(f"the transfer '{wish.id}' has {total} segments")
        if transfer.waiting + len(wanted) > 2 * total:
            raise QueueFull(
                f"{transfer.waiting} segments of '{wish.id}' are already waiting to be sent"
            )
        self._send(transfer, wanted)

    def close(self) -> None:
        """Discard everything."""
        self._queue.clear()
        for transfer in list(self._known.values()):
            self._drop(transfer)
