"""Received segmented transfers: reassembled, with limits on size, number and time."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Callable

from rcp_kernel.errors import (
    PayloadTooLarge,
    QueueFull,
    RcpError,
    SegmentCorrupt,
    SegmentMissing,
)
from rcp_ws.config import WsConfig
from rcp_ws.segments import Segment, digest

__all__ = ["Incoming"]

_LISTED = 1000  # missing segments reported at once


class _Transfer:
    """One incomplete message."""

    __slots__ = ("asked", "facts", "have", "last", "parts", "timer")

    def __init__(self, segment: Segment) -> None:
        self.facts = (segment.total, segment.size, segment.sha256.lower())
        self.parts: dict[int, bytes] = {}
        self.have = 0
        self.asked = False
        self.last = float("-inf")
        self.timer: asyncio.TimerHandle | None = None

    @property
    def missing(self) -> list[int]:
        return [num for num in range(self.facts[0]) if num not in self.parts][:_LISTED]


class Incoming:
    """The received transfers of one connection."""

    def __init__(
        self,
        config: WsConfig,
        *,
        whole: Callable[[bytes], None],
        again: Callable[[str | int, list[int]], None],
        failed: Callable[[str | int, RcpError], None],
    ) -> None:
        self._config = config
        self.limit = 0
        """Maximum message length, in bytes; set by the owner."""
        self._whole = whole
        """Called with each complete message."""
        self._again = again
        """Called to request segments again."""
        self._failed = failed
        """Called when a transfer is dropped."""
        self._transfers: dict[str | int, _Transfer] = {}
        self._held = 0

    def take(self, segment: Segment) -> None:
        """Handle one segment.

        :raises PayloadTooLarge: the message, or all transfers together, are too long.
        :raises QueueFull: there are too many transfers.
        :raises SegmentCorrupt: the segments do not match the announced message.
        """
        transfer = self._transfers.get(segment.id)
        if transfer is None:
            transfer = self._begin(segment)
        total, size, _ = transfer.facts
        if (segment.total, segment.size, segment.sha256.lower()) != transfer.facts:
            self._drop(segment.id)
            raise SegmentCorrupt(f"segment {segment.num} belongs to another message than the first")
        if segment.num >= total:
            self._drop(segment.id)
            raise SegmentCorrupt(f"segment {segment.num} of a transfer with {total} segments")
        if segment.num not in transfer.parts:
            transfer.parts[segment.num] = segment.body
            transfer.have += len(segment.body)
            self._held += len(segment.body)
        if transfer.have > size:
            self._drop(segment.id)
            raise SegmentCorrupt(f"the segments have more than the announced {size} bytes")
        if len(transfer.parts) == total:
            self._complete(segment.id, transfer)
            return
        transfer.last = asyncio.get_running_loop().time()
        if segment.num == total - 1 and not transfer.asked:
            # The stream is in order: segments missing before the last one are lost.
            transfer.asked = True
            self._again(segment.id, transfer.missing)

    def _begin(self, segment: Segment) -> _Transfer:
        if segment.size > self.limit or segment.total > self._config.segments:
            raise PayloadTooLarge(
                f"the transfer has {segment.size} bytes in {segment.total} segments; the limits "
                f"are {self.limit} and {self._config.segments}",
                details={"limit": self.limit, "segments": self._config.segments},
            )
        if len(self._transfers) >= self._config.transfers or self._held > 2 * self.limit:
            raise QueueFull(
                f"this connection already has {len(self._transfers)} incomplete transfers"
            )
        transfer = self._transfers[segment.id] = _Transfer(segment)
        self._watch(segment.id, transfer, self._config.segment_timeout)
        return transfer

    def _watch(self, id_: str | int, transfer: _Transfer, delay: float) -> None:
        loop = asyncio.get_running_loop()
        transfer.timer = loop.call_later(delay, self._look, id_, transfer)

    def _look(self, id_: str | int, transfer: _Transfer) -> None:
        idle = asyncio.get_running_loop().time() - transfer.last
        left = self._config.segment_timeout - idle
        if left > 0.001:
            self._watch(id_, transfer, left)
            return
        missing = transfer.missing
        self._drop(id_)
        self._failed(
            id_,
            SegmentMissing(
                f"no segment for {self._config.segment_timeout:g} s, and "
                f"{transfer.facts[0] - len(transfer.parts)} segments are missing",
                details={"missing": missing},
            ),
        )

    def _complete(self, id_: str | int, transfer: _Transfer) -> None:
        self._drop(id_)
        total, size, sha256 = transfer.facts
        data = b"".join(transfer.parts[num] for num in range(total))
        if len(data) != size:
            raise SegmentCorrupt(f"the segments have {len(data)} bytes, not {size}")
        if not hmac.compare_digest(digest(data), sha256):
            raise SegmentCorrupt("the segments do not match the announced hash")
        self._whole(data)

    def _drop(self, id_: str | int) -> None:
        transfer = self._transfers.pop(id_)
        self._held -= transfer.have
        if transfer.timer is not None:
            transfer.timer.cancel()

    def close(self) -> None:
        """Discard everything."""
        for id_ in list(self._transfers):
            self._drop(id_)
