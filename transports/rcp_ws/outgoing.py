"""Transfers on their way out: one segment for each write turn, so that a map never delays a pose."""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict, deque
from collections.abc import Callable

from rcp_kernel.errors import QueueFull, SegmentMissing
from rcp_kernel.values import Encoding
from rcp_ws.segments import Again, cut, digest, frame

__all__ = ["Outgoing"]

_WAITING = 65_536  # segments
_KEPT_BYTES = 64 * 1024 * 1024  # of transfers that can be asked for again


class _Transfer:
    __slots__ = ("bodies", "id", "until", "whole")

    def __init__(self, id_: str, data: bytes, size: int) -> None:
        self.id = id_
        self.bodies = cut(data, size)
        self.whole = (len(data), digest(data))
        self.until = math.inf
        """Time after which it cannot be asked for again."""


class Outgoing:
    """The segmented transfers of one connection."""

    def __init__(self, encoding: Encoding, kept: float, now: Callable[[], float]) -> None:
        self.size: int | None = None
        """Longest message that goes in one piece; None: every one does."""
        self._encoding = encoding
        self._kept = kept
        self._now = now
        self._numbers = itertools.count(1)
        self._queue: deque[tuple[_Transfer, int]] = deque()
        self._sent: OrderedDict[str, _Transfer] = OrderedDict()
        self._bytes = 0

    @property
    def busy(self) -> bool:
        """Whether segments wait to be sent."""
        return bool(self._queue)

    def sift(self, messages: list[bytes]) -> list[bytes]:
        """Keep the messages that go in one piece; queue the others' segments."""
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
        self._sent[transfer.id] = transfer
        self._bytes += transfer.whole[0]
        self._queue.extend((transfer, num) for num in range(len(transfer.bodies)))

    def next(self) -> bytes:
        """Take the next segment; with the last one its transfer begins to be forgotten."""
        transfer, num = self._queue.popleft()
        if num == len(transfer.bodies) - 1:
            transfer.until = self._now() + self._kept
            self._forget()
        return frame(transfer.id, num, transfer.bodies, transfer.whole, self._encoding)

    def _forget(self) -> None:
        moment = self._now()
        while self._sent:
            oldest = next(iter(self._sent.values()))
            if oldest.until > moment and self._bytes <= _KEPT_BYTES:
                return
            del self._sent[oldest.id]
            self._bytes -= oldest.whole[0]

    def again(self, wish: Again) -> None:
        """Send segments once more.

        :raises SegmentMissing: the transfer is not kept any more, or has no such segment.
        :raises QueueFull: too many segments wait.
        """
        self._forget()
        transfer = self._sent.get(str(wish.id))
        if transfer is None:
            raise SegmentMissing(
                f"the transfer '{wish.id}' is not kept any more",
                remedy="Ask for the value itself again.",
            )
        if any(num >= len(transfer.bodies) for num in wish.resend):
            raise SegmentMissing(f"the transfer '{wish.id}' has {len(transfer.bodies)} segments")
        if len(self._queue) > _WAITING:
            raise QueueFull(f"{len(self._queue)} segments wait to be sent already")
        self._queue.extend((transfer, num) for num in sorted(set(wish.resend)))

    def close(self) -> None:
        """Forget everything."""
        self._queue.clear()
        self._sent.clear()
