"""Updates that are more than a head and a tail: shortened ones, and the first in native bytes."""

from __future__ import annotations

from typing import Any

from rcp_kernel.errors import Overrun
from rcp_kernel.tree.samples import Fields, Sample
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_frame

__all__ = ["first_native", "shortened", "spliced"]

_CBOR_MAP = 0xA0
_MSGPACK_MAP = 0x80
_TAIL = 3  # fields of a tail: number, time and body


def spliced(head: bytes, count: int, encoding: Encoding) -> tuple[bytes, bytes]:
    """Return heads of frames with `count` fields, without and with the number of skipped samples."""
    if encoding is Encoding.JSON:
        head = head[:-1] + b","
        return head, head
    base = (_CBOR_MAP if encoding is Encoding.CBOR else _MSGPACK_MAP) + count + _TAIL
    rest = head[1:]
    return bytes((base,)) + rest, bytes((base + 1,)) + rest


def shortened(
    subscription: str,
    sample: Sample,
    dropped: int,
    fields: Fields,
    encoding: Encoding,
) -> bytes:
    """Return an update with the length of the value instead of the value."""
    facts = _facts(subscription, sample)
    facts |= {"truncated": True, "size": sample.length(encoding, fields)}
    if dropped:
        facts["dropped"] = dropped
    return encode_frame(facts, b"", encoding)


def first_native(
    subscription: str, sample: Sample, dropped: int, type_: str | None, encoding: Encoding
) -> bytes:
    """Return an update of native bytes that names their type.

    :raises Overrun: the sample has none.
    """
    if sample.native is None:
        raise Overrun("the sample has no native form")
    facts = _facts(subscription, sample)
    facts |= {"encoding": "native", "native_type": type_}
    if dropped:
        facts["dropped"] = dropped
    facts["body"] = bytes(sample.native.data)
    return encode_frame(facts, b"", encoding)


def _facts(subscription: str, sample: Sample) -> dict[str, Any]:
    return {
        "type": "update",
        "id": subscription,
        "path": sample.entry.path,
        "seq": sample.seq,
        "timestamp": sample.time,
    }
