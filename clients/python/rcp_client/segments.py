"""Segmented messages: split what is too long for one frame, and join received segments.

Segments of several transfers and whole messages arrive interleaved. Missing segments are requested
again, and finally the transfer ends with an error, never silently.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import time
from dataclasses import dataclass, field
from typing import Any

from rcp_client.messages import Message
from rcp_protocol.errors import PayloadTooLarge, SegmentCorrupt, SegmentMissing

__all__ = ["Assembler", "split"]

_HEAD = 512  # bytes reserved for a segment's own fields
_MAX_TRANSFERS = 64
_MAX_PARTS = 1_000_000


def split(data: bytes, transfer: str, segment_size: int, *, text: bool) -> list[dict[str, Any]]:
    """Split a message into segment envelopes, each of at most `segment_size` bytes when encoded."""
    room = max(256, segment_size - _HEAD)
    step = room // 4 * 3 if text else room  # base64 encodes three bytes as four characters
    parts = [data[at : at + step] for at in range(0, len(data), step)]
    digest = hashlib.sha256(data).hexdigest()
    return [
        {
            "type": "segment",
            "id": transfer,
            "num": num,
            "total": len(parts),
            "size": len(data),
            "sha256": digest,
            "body": part,
        }
        for num, part in enumerate(parts)
    ]


@dataclass(slots=True)
class _Transfer:
    total: int
    size: int
    sha256: str
    received_at: float
    parts: dict[int, bytes] = field(default_factory=dict[int, bytes])
    have: int = 0
    attempts: int = 0

    def missing(self) -> list[int]:
        return [num for num in range(self.total) if num not in self.parts]


class Assembler:
    """The incoming transfers of one connection."""

    def __init__(self, limit: int, *, patience: float, tries: int = 3) -> None:
        self._limit = limit
        """Maximum size of a whole message, bytes."""
        self._patience = patience
        """Seconds without a segment after which missing ones are requested."""
        self._tries = tries
        self._open: dict[str, _Transfer] = {}

    def __len__(self) -> int:
        return len(self._open)

    def add(self, segment: Message) -> bytes | None:
        """Add a segment; return the whole message if it was the last one.

        :raises PayloadTooLarge: the message exceeds the limit, or there are too many transfers.
        :raises SegmentCorrupt: the segment does not fit, or the message does not match its hash;
            `details.missing` lists the segments to request again, if that may help.
        """
        name = segment.id or ""
        transfer = self._open.get(name) or self._begin(name, segment)
        num, body = segment.num, _bytes(segment.body)
        same = segment.total == transfer.total and segment.sha256 == transfer.sha256
        if num is None or not 0 <= num < transfer.total or body is None or not same:
            raise SegmentCorrupt(f"a segment of transfer '{name}' does not fit its header")
        transfer.received_at = time.monotonic()
        if num not in transfer.parts:
            transfer.parts[num] = body
            transfer.have += len(body)
        if transfer.have > transfer.size:
            del self._open[name]
            raise SegmentCorrupt(f"transfer '{name}' is longer than announced")
        if len(transfer.parts) < transfer.total:
            return None
        return self._finish(name, transfer)

    def _begin(self, name: str, segment: Message) -> _Transfer:
        total, size, sha256 = segment.total, segment.size, segment.sha256
        if not name or total is None or size is None or sha256 is None or total < 1 or size < 0:
            raise SegmentCorrupt("a segment lacks its id, total, size or sha256")
        if size > self._limit or total > _MAX_PARTS:
            raise PayloadTooLarge(
                f"the gateway sends a message of {size} bytes; the limit of this client is "
                f"{self._limit}",
                details={"limit": self._limit},
            )
        if len(self._open) >= _MAX_TRANSFERS:
            raise PayloadTooLarge(f"{_MAX_TRANSFERS} transfers are already in progress")
        transfer = self._open[name] = _Transfer(total, size, sha256, time.monotonic())
        return transfer

    def _finish(self, name: str, transfer: _Transfer) -> bytes:
        whole = b"".join(transfer.parts[num] for num in range(transfer.total))
        if len(whole) == transfer.size and hashlib.sha256(whole).hexdigest() == transfer.sha256:
            del self._open[name]
            return whole
        transfer.attempts += 1
        again: list[int] | None = list(range(transfer.total))
        if transfer.attempts > self._tries:
            del self._open[name]
            again = None
        transfer.parts.clear()
        transfer.have = 0
        raise SegmentCorrupt(
            f"transfer '{name}' does not match its hash",
            details=None if again is None else {"missing": again},
        )

    def overdue(self) -> dict[str, list[int]]:
        """Return the segments to request again, by transfer.

        :raises SegmentMissing: a transfer has been requested too often and is given up.
        """
        moment = time.monotonic()
        wanted: dict[str, list[int]] = {}
        for name, transfer in list(self._open.items()):
            if moment - transfer.received_at < self._patience:
                continue
            if transfer.attempts >= self._tries:
                del self._open[name]
                raise SegmentMissing(f"segments of transfer '{name}' did not arrive")
            transfer.attempts += 1
            transfer.received_at = moment
            wanted[name] = transfer.missing()
        return wanted


def _bytes(body: Any) -> bytes | None:
    if isinstance(body, bytes):
        return body
    if isinstance(body, str):
        try:
            return base64.b64decode(body, validate=True)
        except (binascii.Error, ValueError):
            return None
    return None
