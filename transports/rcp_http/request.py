"""One HTTP request as the handlers see it: caller, parameters, envelope fields, encoding."""

from __future__ import annotations

import math
from collections.abc import Hashable
from contextlib import suppress
from typing import Any

import msgspec
from msgspec import Raw

from rcp_gateway.api import Principal, Session
from rcp_gateway.api.pages import MOST
from rcp_gateway.client_api import ClientApi
from rcp_http.negotiate import accepted, body_encoding
from rcp_kernel.errors import BadRequest, NotImplementedByRobot
from rcp_kernel.values import Encoding, parse
from rcp_kernel.wire import Request, decode_request
from rcp_protocol.trace import TRACEPARENT, TRACESTATE
from rcp_scheduling.turns import Turns
from rcp_web.asgi import Receive, Scope, bearer, peer_of, read_parts, too_large
from rcp_web.query import read_query, single

__all__ = ["HttpRequest", "count", "flag", "number"]

_LONG = 256 * 1024  # bytes of a body that waits for a turn
_FIELDS = (
    "deadline",
    "valid_for",
    "dry_run",
    "timestamp",
    "version",
    "idempotency_key",
    "approval",
    "id",
)
_HEADERS = {
    b"authorization": "authorization",
    b"accept": "accept",
    b"accept-encoding": "accept_encoding",
    b"content-type": "content_type",
    b"content-length": "content_length",
    b"content-encoding": "content_encoding",
    b"content-range": "content_range",
    b"if-match": "if_match",
    b"if-unmodified-since": "if_unmodified_since",
    b"if-none-match": "if_none_match",
    b"range": "range",
    b"if-range": "if_range",
    b"prefer": "prefer",
    b"x-rcp-tenant": "tenant",
}
"""The headers in use, by their names here."""
_ENVELOPE: dict[bytes, str] = {}
"""Headers that set fields of the envelope."""
for _field in _FIELDS:
    _ENVELOPE[b"x-rcp-" + _field.replace("_", "-").encode()] = _field
    if _field != "id":
        _ENVELOPE[_field.replace("_", "-").encode()] = _field
        _ENVELOPE[_field.encode()] = _field
# Proxies and tracing libraries send it as a header.
_ENVELOPE |= {b"traceparent": TRACEPARENT, b"tracestate": TRACESTATE}
_CONDITIONS = {
    "if_match": "If-Match",
    "if_none_match": "If-None-Match",
    "if_unmodified_since": "If-Unmodified-Since",
}
_MAX_PARAMETERS = 500


class HttpRequest:
    """The head of a request, parsed once."""

    __slots__ = (
        "encoding",
        "envelope",
        "headers",
        "method",
        "octets",
        "path",
        "peer",
        "query",
        "root_path",
    )

    def __init__(self, scope: Scope) -> None:
        headers: dict[str, bytes] = {}
        envelope: dict[str, bytes] = {}
        for name, value in scope["headers"]:
            if (used := _HEADERS.get(name)) is not None:
                headers[used] = value
            elif (field := _ENVELOPE.get(name)) is not None:
                envelope[field] = value
        self.headers = headers
        """The headers in use."""
        self.envelope = envelope
        """Envelope fields from headers."""
        self.method: str = "GET" if scope["method"] == "HEAD" else scope["method"]
        self.path: str = scope["path"]
        self.peer = peer_of(scope)
        self.root_path: str = scope.get("root_path", "")
        self.query: dict[str, list[str]] = {}
        self.encoding = Encoding.JSON
        self.octets = False
        if scope["query_string"]:
            self.query = read_query(scope["query_string"], _MAX_PARAMETERS)

    def negotiate(self) -> None:
        """Determine the encoding of the response.

        :raises BadRequest: the client accepts none of the supported ones.
        """
        accept = self.headers.get("accept")
        if accept is not None and accept != b"*/*":
            self.encoding, self.octets = accepted(accept)

    def session(self, client_api: ClientApi) -> Session | None:
        """Return the caller's session; None if this takes a while: then await `waited`.

        :raises Unauthenticated: the token is invalid, or required and missing.
        :raises Forbidden: the caller has no rights in the requested tenant.
        """
        principal = client_api.known(bearer(self.headers.get("authorization")), self.peer)
        return None if principal is None else self._session(client_api, principal)

    async def waited(self, client_api: ClientApi) -> Session:
        """Return the caller's session, waiting for authentication if necessary.

        :raises RcpError: see `session`.
        """
        token = bearer(self.headers.get("authorization"))
        return self._session(client_api, await client_api.identify(token, self.peer))

    def _session(self, client_api: ClientApi, principal: Principal) -> Session:
        tenant = self.one("tenant") if self.query else None
        if tenant is None and (named := self.headers.get("tenant")) is not None:
            tenant = named.decode("latin-1")
        return client_api.session(principal, tenant, self.peer)

    def one(self, name: str) -> str | None:
        """Return a parameter that may occur once.

        :raises BadRequest: it occurs twice.
        """
        values = self.query.get(name)
        return None if values is None else single(name, values)

    def allow(self, *names: str) -> None:
        """Refuse parameters other than `names`, envelope fields and `x-…`.

        :raises BadRequest: there is one.
        """
        for name in self.query:
            if name in names or name in _FIELDS or name in ("tenant", "wait"):
                continue
            if not name.startswith("x-"):
                known = ", ".join((*names, *_FIELDS, "tenant"))
                raise BadRequest(
                    f"unknown parameter {name[:60]!r}",
                    remedy=f"The parameters are {known}; custom parameters are named x-<name>.",
                )

    def request(self, type_: str, path: str | None = None) -> Request:
        """Build the envelope, with the fields from parameters and headers.

        :raises BadRequest: one of them is invalid.
        """
        fields = self._fields() if self.envelope or self.query else None
        if not fields:
            return Request(type=type_, path=path)  # pyright: ignore[reportArgumentType] - a literal
        fields["type"] = type_
        if path is not None:
            fields["path"] = path
        return decode_request(msgspec.json.encode(fields), Encoding.JSON)

    def _fields(self) -> dict[str, Any]:
        fields: dict[str, Any] = {
            name: value.decode("latin-1") for name, value in self.envelope.items()
        }
        for name in self.query:
            if name in _FIELDS or name.startswith("x-"):
                fields[name] = self.one(name)
        for name in ("deadline", "valid_for"):
            if name in fields:
                fields[name] = number(name, fields[name])
        if "dry_run" in fields:
            fields["dry_run"] = flag("dry_run", fields["dry_run"])
        if "timestamp" in fields:
            with suppress(ValueError):  # ISO 8601; otherwise the value is refused as neither
                fields["timestamp"] = float(fields["timestamp"])
        return fields

    @property
    def wait(self) -> float | None:
        """Seconds to wait for the final reply, from `?wait` or `Prefer: wait`.

        :raises BadRequest: it is not a number.
        """
        text = self.one("wait")
        if text is None:
            for part in self.headers.get("prefer", b"").decode("latin-1").split(","):
                key, _, value = part.partition(";")[0].partition("=")
                if key.strip().lower() == "wait":
                    text = value.strip().strip('"')
        return None if text is None else number("wait", text)

    @property
    def at_once(self) -> bool:
        """Whether the client does not want to wait: `Prefer: respond-async` (RFC 7240)."""
        return b"respond-async" in self.headers.get("prefer", b"").lower()

    def check_unconditional(self) -> None:
        """Refuse conditional changes, because conditions are not supported.

        :raises NotImplementedByRobot: there is such a header.
        """
        for name, header in _CONDITIONS.items():
            if name in self.headers:
                raise NotImplementedByRobot(
                    f"`{header}` is not supported for requests that change something",
                    remedy="Omit the header; acquire a lease for exclusive control.",
                )

    async def body(
        self, receive: Receive, limit: int, patience: float, turns: Turns, owner: Hashable
    ) -> bytes:
        """Read the body; a long one waits for a turn of `owner`, and there is one in each turn.

        :raises PayloadTooLarge: it exceeds `limit`.
        :raises DeadlineExceeded: it did not arrive in time.
        :raises BadRequest: it has a content coding, or is partial.
        """
        coding = self.headers.get("content_encoding", b"identity").strip().lower()
        if coding != b"identity":
            text = coding.decode("latin-1")[:40]
            raise BadRequest(
                f"the content coding {text!r} is not supported",
                remedy="Send the body without a content coding.",
            )
        if "content_range" in self.headers:
            raise BadRequest("partial writes are not supported", remedy="Send the whole value.")
        length = self.headers.get("content_length", b"")
        if length.isdigit() and int(length) > limit:
            raise too_large(limit)
        parts = await read_parts(receive, limit, patience)
        if sum(map(len, parts)) < _LONG:
            return b"".join(parts)
        await turns.wait(owner)
        with turns.spending():
            return b"".join(parts)

    def put_body(self, request: Request, data: bytes) -> None:
        """Decode the HTTP body into the request's body, by its Content-Type.

        :raises BadRequest: it is malformed, or its type is not supported.
        """
        encoding = body_encoding(self.headers.get("content_type", b""))
        if encoding is None:
            request.body, request.encoding = Raw(msgspec.msgpack.encode(data)), Encoding.MSGPACK
        elif encoding is Encoding.CBOR and data:
            plain = parse(data, Encoding.CBOR)
            request.body, request.encoding = Raw(msgspec.msgpack.encode(plain)), Encoding.MSGPACK
        elif data:
            trimmed = data.strip() if encoding is Encoding.JSON else data
            if not trimmed:
                remedy = "Send a JSON value, or a request without a body."
                raise BadRequest("a body of whitespace alone is not JSON", remedy=remedy)
            request.body, request.encoding = Raw(trimmed), encoding


def number(name: str, text: str) -> float:
    """Parse a numeric parameter.

    :raises BadRequest: it is not a number.
    """
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not math.isfinite(found) or found < 0:
        raise BadRequest(f"`{name}` must be a number of seconds, not {text[:40]!r}")
    return found


def count(name: str, text: str) -> int:
    """Parse a page size.

    :raises BadRequest: it is not a number within the limits.
    """
    if not (text.isascii() and text.isdigit()) or not 1 <= int(text[:9]) <= MOST:
        raise BadRequest(f"`{name}` must be a number from 1 to {MOST}, not {text[:40]!r}")
    return int(text)


def flag(name: str, text: str) -> bool:
    """Parse a boolean parameter; empty means true.

    :raises BadRequest: it is neither true nor false.
    """
    known = {"true": True, "1": True, "": True, "false": False, "0": False}
    if text.lower() not in known:
        raise BadRequest(f"`{name}` must be true or false, not {text[:40]!r}")
    return known[text.lower()]
