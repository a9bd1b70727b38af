"""ASGI helpers for serving a `Mount`: the caller of a request, and replies over HTTP."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from math import ceil
from typing import Any

from rcp_gateway.api import UNKNOWN_PEER, Peer, Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BY_CODE, BadRequest, DeadlineExceeded, PayloadTooLarge, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, encode_reply, failure
from rcp_protocol.timeouts import timeout

__all__ = [
    "JSON",
    "MEDIA",
    "Headers",
    "Receive",
    "Scope",
    "Send",
    "bearer",
    "header",
    "peer_of",
    "read_body",
    "read_parts",
    "refusal_headers",
    "refuse",
    "respond",
    "retry_after",
    "session_of",
    "status_of",
    "too_large",
    "until_gone",
]

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
Headers = list[tuple[bytes, bytes]]

JSON = b"application/json"
MEDIA = {
    Encoding.JSON: JSON,
    Encoding.CBOR: b"application/cbor",
    Encoding.MSGPACK: b"application/msgpack",
}
"""The media type of each encoding."""
_UNREAD = 64 * 1024  # bytes of a body that means nothing
_WITHOUT_ERROR = {"completed": 200, "failed": 502, "rejected": 409, "cancelled": 499}
"""HTTP statuses of final replies that name no error, as a plugin may send them."""


def header(scope: Scope, name: bytes) -> bytes | None:
    """Return the first header of a name (in lower case), or None."""
    for key, value in scope["headers"]:
        if key == name:
            return value
    return None


def bearer(authorization: bytes | None) -> str | None:
    """Return the token of an `Authorization` header, or None if there is no header.

    :raises BadRequest: it is not a bearer token.
    """
    if authorization is None:
        return None
    scheme, _, token = authorization.partition(b" ")
    if scheme.lower() != b"bearer" or not token.strip():
        raise BadRequest(
            "the Authorization header is not a bearer token",
            remedy="Send `Authorization: Bearer <token>`.",
        )
    return token.strip().decode("latin-1")


def peer_of(scope: Scope) -> Peer:
    """Return the peer of a request's connection, as the listener knows it."""
    extensions = scope.get("extensions")
    found = None if extensions is None else extensions.get("rcp.peer")
    return UNKNOWN_PEER if found is None else found


async def read_body(receive: Receive, limit: int, patience: float | None) -> bytes:
    """Read a request's body; raises as `read_parts`."""
    return b"".join(await read_parts(receive, limit, patience))


async def read_parts(receive: Receive, limit: int, patience: float | None) -> list[bytes]:
    """Read a request's body, in the parts that have come: to join megabytes takes milliseconds.

    :raises PayloadTooLarge: it is longer than `limit` bytes.
    :raises DeadlineExceeded: it did not arrive within `patience` seconds, if there is a limit.
    :raises BadRequest: the connection ended before.
    """
    parts: list[bytes] = []
    size = 0
    more = True
    try:
        async with timeout(patience):
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":  # half a value must not reach a robot
                    raise BadRequest("the connection closed before the body was complete")
                parts.append(message.get("body", b""))
                size += len(parts[-1])
                if size > limit:
                    raise too_large(limit)
                more = message.get("more_body")
    except TimeoutError:
        raise DeadlineExceeded(f"the body was not complete within {patience:g} s") from None
    return parts


async def until_gone(receive: Receive) -> None:
    """Return once the client has closed the connection, or sends a body without an end.

    To be called while a response is sent whose request has no body that matters: a short one is skipped.
    """
    size = 0
    while size <= _UNREAD:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        size += len(message.get("body", b""))


def too_large(limit: int) -> PayloadTooLarge:
    """Return the error for a body longer than `limit` bytes."""
    return PayloadTooLarge(f"the body is longer than {limit} bytes", details={"limit": limit})


async def session_of(client_api: ClientApi, scope: Scope, tenant: str | None = None) -> Session:
    """Return the stateless session of the caller; `X-RCP-Tenant` names one of its tenants.

    :raises Unauthenticated: the token is not good, or there has to be one.
    :raises Forbidden: the caller does not act in that tenant.
    """
    named = header(scope, b"x-rcp-tenant")
    if tenant is None and named is not None:
        tenant = named.decode("latin-1")
    token = bearer(header(scope, b"authorization"))
    peer = peer_of(scope)
    return client_api.session(await client_api.identify(token, peer), tenant, peer)


def status_of(reply: Reply) -> int:
    """Return the HTTP status of a reply, by the protocol's table of codes.

    2xx is for completed or continuing requests, never for failed ones.
    """
    if reply.error is None:
        return _WITHOUT_ERROR.get(reply.status, 202)
    known = BY_CODE.get(reply.error["code"])
    return known.http if known is not None else 500


async def respond(
    send: Send,
    status: int,
    body: bytes,
    media: bytes = JSON,
    headers: Iterable[tuple[bytes, bytes]] = (),
) -> None:
    """Send a whole response."""
    fields = [*headers]
    if status not in (204, 304):
        fields += (b"content-type", media), (b"content-length", b"%d" % len(body))
    await send({"type": "http.response.start", "status": status, "headers": fields})
    await send({"type": "http.response.body", "body": body})


def retry_after(seconds: float | None) -> Headers:
    """Return the Retry-After header, rounded up."""
    return [] if seconds is None else [(b"retry-after", b"%d" % max(1, ceil(seconds)))]


def refusal_headers(error: RcpError) -> Headers:
    """Return the headers for an error: how to log in, and when to retry."""
    headers = retry_after(error.retry_after)
    if error.http == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    return headers


async def refuse(
    send: Send,
    error: RcpError,
    type_: str = "error",
    *,
    id_: str | None = None,
    path: str | None = None,
    encoding: Encoding = Encoding.JSON,
    status: int | None = None,
    headers: Iterable[tuple[bytes, bytes]] = (),
) -> None:
    """Answer with the envelope of an error."""
    reply = failure(error, type_, id_, path)
    fields = [*headers, *refusal_headers(error)]
    body = encode_reply(reply, encoding)
    await respond(send, status or error.http, body, MEDIA[encoding], fields)
