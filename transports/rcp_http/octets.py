"""Values of bytes as raw bodies, whole or a range (RFC 9110, section 14)."""

from __future__ import annotations

from typing import Any

from rcp_gateway.api import Sample
from rcp_http.answers import BOOT, matches
from rcp_http.negotiate import OCTETS
from rcp_http.request import HttpRequest
from rcp_kernel.wire import Reply
from rcp_web.asgi import Headers, Send, respond
from rcp_web.ranges import byte_range

__all__ = ["bytes_of", "send_octets"]

_MEDIA = OCTETS.encode()


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
