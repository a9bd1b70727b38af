"""Files that are sent piece by piece: recordings, and tables of what was recorded."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Any, cast

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_http.answers import matches
from rcp_http.request import HttpRequest
from rcp_kernel.errors import NotImplementedByRobot, RcpError
from rcp_protocol.timeouts import timeout
from rcp_web.asgi import Headers, Receive, Send, read_parts, respond, until_gone
from rcp_web.downloads import RECORDINGS, Download, Recordings
from rcp_web.ranges import byte_range

__all__ = ["HISTORY", "SENT_AS_LIST", "history_options", "recordings", "send_download"]

HISTORY = ("from", "to", "before", "every", "thin", "fields", "limit", "cursor", "format")
"""Parameters of a read of what was recorded; one of `from`, `to` and `every` makes it one."""
SENT_AS_LIST = "fields"
_LONGEST_BODY = 64 * 1024  # bytes
_BODY_PATIENCE = 10.0  # s
_STALLED = 60.0  # s that a client may take no bytes


def recordings(client_api: ClientApi) -> Recordings:
    """Return the recordings of the gateway.

    :raises NotImplementedByRobot: it has no recorder.
    """
    found = client_api.service(RECORDINGS)
    if found is None:
        raise NotImplementedByRobot(
            "this gateway records nothing",
            remedy="Ask its operator to configure [features.recorder].",
        )
    return found


def history_options(http: HttpRequest, path: str) -> dict[str, Any]:
    """Return the options of a request for history, as they are in the query."""
    wanted: dict[str, Any] = {"path": path}
    for name in HISTORY:
        if (text := http.one(name)) is not None and name != "format":
            wanted[name] = [one for one in text.split(",") if one] if name == SENT_AS_LIST else text
    return wanted


async def send_download(
    receive: Receive, send: Send, http: HttpRequest, session: Session, download: Download
) -> None:
    """Answer with a file, or a part of it where its size is known.

    It ends with the session, and as soon as the client is gone: a listener discards what is sent to
    nobody, and the file would be read to its end. A body of the request means nothing, and is read
    before: from then on, only the end of the connection can come.

    :raises PayloadTooLarge: the body is longer than any that means nothing has to be.
    :raises DeadlineExceeded: the body did not arrive in time.
    """
    await read_parts(receive, _LONGEST_BODY, _BODY_PATIENCE)
    size, headers = download.size, _headers(download)
    start, stop, status = 0, size, 200
    if size is not None:
        etag = (
            b'"%b"' % hashlib.sha256(f"{download.name}.{size}".encode()).hexdigest()[:16].encode()
        )
        headers += [(b"accept-ranges", b"bytes"), (b"etag", etag)]
        if matches(http, etag):
            await respond(send, 304, b"", headers=headers)
            return
        wanted = http.headers.get("range")
        if wanted is not None and http.headers.get("if_range", etag) == etag:
            part = byte_range(wanted.decode("latin-1"), size)
            if part is not None:
                (start, stop), status = part, 206
                headers.append((b"content-range", b"bytes %d-%d/%d" % (start, stop - 1, size)))
        headers.append((b"content-length", b"%d" % ((stop or 0) - start)))
    head = {"type": "http.response.start", "status": status, "headers": headers}
    sending = asyncio.ensure_future(_send_pieces(send, session, head, download.pieces(start, stop)))
    gone = asyncio.ensure_future(until_gone(receive))
    try:
        await asyncio.wait((sending, gone), return_when=asyncio.FIRST_COMPLETED)
    finally:
        gone.cancel()
        if not sending.done():
            sending.cancel()
            await asyncio.wait((sending,))
    if not sending.cancelled():
        sending.result()


async def _send_pieces(
    send: Send, session: Session, head: dict[str, Any], download: AsyncIterator[bytes]
) -> None:
    over: list[RcpError] = []
    ended = over.append
    session.endings.add(ended)
    try:
        async with aclosing(cast("Any", download)) as pieces:
            first = await anext(pieces, b"")  # tells whether there is an answer at all
            await send(head)
            await _send(send, first)
            async for piece in pieces:
                if over:
                    return  # an answer without an end: its client sees that it is cut off
                await _send(send, piece)
    finally:
        session.endings.discard(ended)
    await send({"type": "http.response.body", "body": b""})


async def _send(send: Send, piece: bytes) -> None:
    async with timeout(_STALLED):
        await send({"type": "http.response.body", "body": piece, "more_body": True})


def _headers(download: Download) -> Headers:
    name = "".join(c if c.isalnum() or c in "._-" else "_" for c in download.name)
    return [
        (b"content-type", download.media.encode()),
        (b"content-disposition", f'attachment; filename="{name}"'.encode()),
        (b"cache-control", b"private, no-cache"),
        (b"vary", b"accept, authorization, x-rcp-tenant"),
    ]
