"""One page of history: rows that fit into a reply, encoded as the client has them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from rcp_protocol.clock import iso
from rcp_protocol.values import Encoding, dump
from rcp_recordings.lead import Room
from rcp_recordings.query import Query
from rcp_recordings.rows import Interval, Row
from rcp_recordings.tables import Rows

__all__ = ["as_page"]

_PAGE = 2**20  # bytes
_encode = msgspec.json.Encoder().encode


def as_page(
    rows: Rows, query: Query, lead: Iterable[Row] = (), left_out: Iterable[str] = ()
) -> bytes:
    """Encode one page, with the place of the next: its time, and the rows of that time that were had.

    `lead` is before it, by rank, as far as it fits; of the resources `left_out` some did not fit.
    """
    room = Room(query.room)
    shown = _begun(lead, room, named=query.named)
    limit = query.limit + len(shown)
    size, last, same = 0, query.start, 0
    cursor: str | None = None
    kind = "samples"
    for row in rows:
        moment = row[0]
        same = same + 1 if moment == last else 1
        last = moment
        if moment == query.start and same <= query.skip:
            continue
        data = _encode(_facts(row, named=query.named))
        if isinstance(row, Interval):
            kind = "intervals"
        if len(shown) >= limit or (size and size + len(data) > _PAGE):
            cursor = f"{moment}.{same - 1}"
            break
        shown.append(data)
        size += len(data)
    page: dict[str, Any] = query.facts | {kind: msgspec.Raw(b"[%b]" % b",".join(shown))}
    if missing := room.left_out.union(left_out):
        page["left_out"] = sorted(missing)
    if cursor is not None and not query.apart:
        page["cursor"] = cursor
    whole = _encode(page)
    if query.encoding is not Encoding.JSON:
        whole = dump(msgspec.json.decode(whole), query.encoding)
    return b"%b\n%b" % ((cursor or "").encode(), whole) if query.apart else whole


def _begun(lead: Iterable[Row], room: Room, *, named: bool) -> list[bytes]:
    """Encode what fits of the lead, in the order of time."""
    kept: list[tuple[int, bytes]] = []
    for row in lead:
        data = _encode(_facts(row, named=named))
        if room.takes(row.path, len(data)):
            kept.append((row.received, data))
    kept.sort(key=lambda one: one[0])
    return [data for _, data in kept]


def _facts(row: Row | Interval, *, named: bool) -> dict[str, Any]:
    if isinstance(row, Row):
        return ({"path": row.path} if named else {}) | {
            "timestamp": iso(row.timestamp),
            "received": iso(row.received),
            "seq": row.seq,
            "body": row.value,
        }
    return {
        "from": iso(row.start),
        "count": row.samples,
        "min": _bare(row.least),
        "max": _bare(row.most),
        "mean": _bare(row.mean),
    }


def _bare(numbers: dict[str, float]) -> Any:
    """Return the number of a value that is one, else those of its fields."""
    return numbers[""] if numbers.keys() == {""} else numbers
