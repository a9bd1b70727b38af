"""Values of bytes as raw bodies, whole or a range (RFC 9110, section 14)."""

from __future__ import annotations

import re
from typing import Any

from rcp_http.answers import BOOT, matches
from rcp_http.negotiate import OCTETS
from rcp_http.request import HttpRequest
from rcp_kernel.api import Sample
from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.wire import Reply
from rcp_web.asgi import Headers, Send, respond

__all__ = ["byte_range", "bytes_of", "range_headers", "send_octets"]

_RANGE = re.compile(r"bytes=(\d*)-(\d*)\Z")
_MEDIA = OCTETS.encode()


class NotSatisfiable(BadRequest):
    """The range is outside the value."""

    http = 416


def bytes_of(reply: Reply, *, native: bool) -> bytes | None:
    """Return the bytes of a reply's body, or of its only field; None if it has none.

    With `native`, a value that a backend serialised is returned in its serialised form.
    """
    body: Any = reply.body
    if isinstance(body, Sample):
        body = body.native.data if native and body.native is not None else body.value
    while isinstance(body, dict) and len(body) == 1:
        body = next(iter(body.values()))
    return bytes(body) if isinstance(body, (bytes, bytearray, memoryview)) else None


async def send_octets(send: Send, http: HttpRequest, reply: Reply, data: bytes) -> None:
    """Answer with raw bytes.

    :raises NotSatisfiable: the requested range is outside the value.
    """
    etag = b'"%b.%d"' % (BOOT, reply.seq or 0)
    headers: Headers = [(b"accept-ranges", b"bytes"), (b"etag", etag), (b"vary", b"accept")]
    if reply.source_timestamp is not None:
        headers.append((b"x-rcp-timestamp", reply.source_timestamp.encode()))
    if matches(http, etag):
        await respond(send, 304, b"", headers=headers)
        return
    wanted = http.headers.get("range")
    if wanted is not None and http.headers.get("if_range", etag) == etag:
        part = byte_range(wanted.decode("latin-1"), len(data))
        if part is not None:
            start, stop = part
            headers.append((b"content-range", b"bytes %d-%d/%d" % (start, stop - 1, len(data))))
            await respond(send, 206, data[start:stop], _MEDIA, headers)
            return
    await respond(send, 200, data, _MEDIA, headers)


def byte_range(text: str, size: int) -> tuple[int, int] | None:
    """Return the part that a `Range` header names; None: the whole is a valid response too.

    :raises NotSatisfiable: it is outside.
    """
    match = _RANGE.match(text.strip())
    if match is None or match[0] == "bytes=-":
        return None  # several ranges or another unit
    if match[1]:
        start = int(match[1])
        stop = min(size, int(match[2]) + 1) if match[2] else size
    else:
        start, stop = max(0, size - int(match[2])), size
    if start >= stop:
        raise NotSatisfiable(f"the value has {size} bytes", details={"size": size})
    return start, stop


def range_headers(error: RcpError) -> Headers:
    """Return the header with the size, for a range outside the value."""
    if isinstance(error, NotSatisfiable) and error.details is not None:
        return [(b"content-range", b"bytes */%d" % error.details["size"])]
    return []
