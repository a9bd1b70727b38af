"""From a reply to a response: status, headers, validators, content coding."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from time import perf_counter
from typing import Any

from rcp_gateway.api import (
    BACKLOG_SHARE,
    Outbound,
    PromptReply,
    Turns,
    left_out,
    to_internal_error,
)
from rcp_http.compress import compress
from rcp_http.config import HttpConfig
from rcp_http.negotiate import coding
from rcp_http.request import HttpRequest
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, encode_reply, failure
from rcp_web.asgi import MEDIA, Headers, Send, retry_after, status_of

__all__ = ["BOOT", "Answers", "matches", "methods_of"]

BOOT = secrets.token_hex(4).encode()
"""Part of every validator, because numbers restart with the process."""
_MEDIA = {encoding: (b"content-type", name) for encoding, name in MEDIA.items()}
_NO_CACHE = (b"cache-control", b"no-cache")
_VARY = (b"vary", b"accept, accept-encoding, authorization, x-rcp-tenant")
MESSAGES = "/rcp/v1/messages"
_CODED = {name: (b"content-encoding", name.encode()) for name in ("zstd", "gzip")}
_METHODS = {"read": ("GET", "HEAD"), "write": ("PUT",), "execute": ("POST",)}


class Answers:
    """Writes responses."""

    def __init__(self, config: HttpConfig, outbound: Outbound, turns: Turns) -> None:
        self._outbound = outbound
        self._turns = turns
        self._threshold = config.compress_above

    async def reply(
        self, send: Send, http: HttpRequest, reply: Reply, headers: Headers | None = None
    ) -> None:
        """Answer with an envelope."""
        etag = None
        if reply.seq is not None and reply.type == "read" and reply.error is None:
            etag = _etag(reply.seq, stale=reply.state == "stale")
        if etag is not None and matches(http, etag):
            await self.unchanged(send, etag)
            return
        # Values are validated when they are encoded, so the outcome is known only now.
        began = perf_counter()
        told, data = _encode(reply, http.encoding)
        if len(data) > BACKLOG_SHARE:
            self._turns.add(perf_counter() - began)
        if not self._outbound.has_room(len(data)):
            told, data = _encode(left_out(reply, len(data)), http.encoding)
        status = status_of(told)
        found = [] if headers is None else headers
        if told.error is not None:
            etag = None
            found += _error_headers(status, told.error, http)
        if told.command is not None and http.method == "POST":
            place = f"{http.root_path}/rcp/v1/commands/{told.command}"
            found.append((b"location", place.encode("latin-1")))
        await self.body(send, http, status, data, found, etag)

    async def prompt(
        self, send: Send, http: HttpRequest, path: str, prompt: PromptReply, began: float
    ) -> None:
        """Answer with the value of a read of `path`, which `began` a moment ago."""
        etag = _etag(prompt.seq, stale=prompt.stale)
        if matches(http, etag):
            await self.unchanged(send, etag)
            return
        size = len(prompt.data)
        if size > BACKLOG_SHARE:
            self._turns.add(perf_counter() - began)
            if not self._outbound.has_room(size):
                await self.reply(send, http, left_out(Reply(type="read", path=path), size))
                return
        await self.body(send, http, 200, prompt.data, [], etag)

    async def unchanged(self, send: Send, etag: bytes) -> None:
        """Respond that the client's copy is current."""
        headers = [(b"etag", etag), _NO_CACHE, _VARY]
        await _send(send, 304, headers, b"")

    async def body(
        self,
        send: Send,
        http: HttpRequest,
        status: int,
        data: bytes,
        headers: Headers,
        etag: bytes | None = None,
    ) -> None:
        """Send an encoded response, compressed if worthwhile."""
        headers += _MEDIA[http.encoding], _NO_CACHE, _VARY
        if etag is not None:
            headers.append((b"etag", etag))
        if len(data) > self._threshold and (how := http.headers.get("accept_encoding")) is not None:
            chosen = coding(how)
            if chosen is not None:
                data = await compress(data, chosen)
                headers.append(_CODED[chosen])
        headers.append((b"content-length", b"%d" % len(data)))
        if len(data) <= BACKLOG_SHARE:
            await _send(send, status, headers, data)
            return
        backlog = self._outbound.open()
        backlog.set(len(data))  # an earlier response may have to be sent first
        try:
            await _send(send, status, headers, data)
        finally:
            backlog.close()


async def _send(send: Send, status: int, headers: Headers, data: bytes) -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": data})


def _etag(seq: int, *, stale: bool) -> bytes:
    return b'W/"%b.%d.%b"' % (BOOT, seq, b"s" if stale else b"f")


def matches(http: HttpRequest, etag: bytes) -> bool:
    """Return whether If-None-Match contains this validator."""
    named = http.headers.get("if_none_match")
    if named is None:
        return False
    wanted = etag.removeprefix(b"W/")
    return named.strip() == b"*" or any(
        part.strip().removeprefix(b"W/") == wanted for part in named.split(b",")
    )


def _encode(reply: Reply, encoding: Encoding) -> tuple[Reply, bytes]:
    """Encode a reply; if that fails, encode the error."""
    try:
        return reply, encode_reply(reply, encoding)
    except Exception as error:
        told = to_internal_error(error, path=reply.path)
        failed = failure(told, reply.type, reply.id, reply.path, command=reply.command)
        return failed, encode_reply(failed, encoding)


def methods_of(operations: Iterable[str]) -> list[str]:
    """Return the HTTP methods of a resource with some operations."""
    return [*(m for name in operations for m in _METHODS.get(name, ())), "OPTIONS"]


def _error_headers(status: int, error: dict[str, Any], http: HttpRequest) -> Headers:
    headers: Headers = []
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    headers += retry_after(error.get("retry_after"))
    if status == 405:
        # A posted envelope names the resource itself; its URL only supports POST.
        posted = http.path == MESSAGES
        allowed = ("execute",) if posted else (error.get("details") or {}).get("allowed", ())
        headers.append((b"allow", ", ".join(methods_of(allowed)).encode()))
    return headers
