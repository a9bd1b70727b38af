"""Envelopes: requests and replies, and their encodings.

A request body stays encoded (`msgspec.Raw`) until the resource's type decodes it, and a reply body
may already be encoded: envelopes are spliced around it. The CBOR library cannot splice, so a CBOR
request is converted to MessagePack on arrival.
"""

from __future__ import annotations

import re
import uuid
from typing import Annotated, Any, Literal, get_args

import cbor2
import msgspec
from msgspec import Meta, Raw

from rcp_protocol.clock import iso, now, parse_time
from rcp_protocol.errors import BadRequest, PayloadTooLarge, RcpError, VersionUnsupported
from rcp_protocol.plain import is_map
from rcp_protocol.values import ANY, Encoding, ValueType, parse, sound

__all__ = [
    "FINAL",
    "NO_BODY",
    "VERSION",
    "Body",
    "Reply",
    "Request",
    "RequestType",
    "Status",
    "check_size",
    "decode_request",
    "encode_body",
    "encode_frame",
    "encode_reply",
    "error_body",
    "failure",
    "fields_of",
    "peek_header",
]

VERSION = "1"
RequestType = Literal[
    "read",
    "write",
    "execute",
    "subscribe",
    "unsubscribe",
    "cancel",
    "discover",
    "status",
    "hello",
    "ping",
    "batch",
]
Status = Literal[
    "accepted", "pending", "in_progress", "completed", "failed", "rejected", "cancelled"
]
FINAL = frozenset(("completed", "failed", "rejected", "cancelled"))
NO_BODY = Raw()
_MAX_DEADLINE = 86_400.0  # s
_MAX_CUSTOM = 16_384  # bytes of all x-… fields, which are stored with commands and audit records
_Id = Annotated[str, Meta(min_length=1, max_length=128)]


class Request(
    msgspec.Struct,
    kw_only=True,
    forbid_unknown_fields=True,
    rename={"custom": "x-", "encoding": "~encoding"},
):
    """One request envelope, validated except for its body, which is still encoded."""

    type: RequestType
    path: str | None = None
    id: _Id | None = None
    timestamp: str | int | float | None = None
    deadline: Annotated[float, Meta(gt=0, le=_MAX_DEADLINE)] | None = None
    version: str | None = None
    idempotency_key: Annotated[str, Meta(min_length=1, max_length=256)] | None = None
    valid_for: Annotated[float, Meta(gt=0, le=3600)] | None = None
    dry_run: bool = False
    approval: Annotated[str, Meta(min_length=1, max_length=64)] | None = None
    """Id of the approval that admits a `write` or `execute` once."""
    command: Annotated[str, Meta(max_length=128)] | None = None
    """The gateway's id of the command to `cancel`."""
    body: Raw = NO_BODY
    custom: dict[str, Any] | None = None
    """The envelope's `x-…` fields."""
    encoding: Encoding = Encoding.JSON
    """Encoding of `body`: JSON or MSGPACK."""

    def decode_body(self, type_: ValueType, label: str = "body") -> Any:
        """Decode the body as a type; an absent body counts as `null`.

        :raises InvalidValue: it does not match the type.
        """
        if not self.body:
            return type_.convert(None, label)
        return type_.decode(self.body, self.encoding, label)


class Body:
    """A reply body that caches its encodings: a sample's value, encoded once for all receivers."""

    __slots__ = ()
    truncated = False
    """Whether it is incomplete."""

    @property
    def value(self) -> Any:
        """The body as a Python value."""
        raise NotImplementedError

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the body in an encoding."""
        raise NotImplementedError


class Reply(msgspec.Struct, kw_only=True, omit_defaults=True):
    """One reply envelope; `body` is plain data, a `Body`, or `NO_BODY`.

    The gateway writes the usual reply to `read` without it: `Sample.read_piece` of the kernel.
    """

    type: str
    id: str | None = None
    path: str | None = None
    status: Status = msgspec.field(default_factory=lambda: "completed")  # always written
    body: Any = NO_BODY
    message: str | None = None
    error: dict[str, Any] | None = None
    command: str | None = None
    progress: float | None = None
    seq: int | None = None
    source_timestamp: str | None = None
    """When the source measured the value of a read."""
    state: Literal["fresh", "stale"] | None = None
    """Whether an update of the value is overdue."""
    truncated: bool = False
    """Whether the body is incomplete: `cursor` continues it."""
    cursor: str | None = None
    timestamp: str | None = None
    dry_run: bool = False
    custom: dict[str, Any] | None = msgspec.field(default=None, name="x-")

    @property
    def final(self) -> bool:
        """Whether this reply ends its request."""
        return self.status in FINAL


_PEEKED = 65_536  # bytes beyond which a message is not parsed to answer that it is malformed
_PEEK = 4096  # bytes of it that are inspected
_SPARE = 65_536  # bytes that an envelope may have besides its body
_TYPE_TEXT = re.compile(rb'"type"\s*:\s*"([a-z]{1,16})"')
_ID_TEXT = re.compile(rb'"id"\s*:\s*"([ !#-\[\]-~]{1,128})"')
_KNOWN = frozenset(f.encode_name for f in msgspec.structs.fields(Request)) - {"x-", "~encoding"}
_from_json = msgspec.json.Decoder(Request)
_from_msgpack = msgspec.msgpack.Decoder(Request)


class _Shell(msgspec.Struct):
    """An envelope with any fields, to find its body."""

    body: Raw = NO_BODY


_shell_json = msgspec.json.Decoder(_Shell)
_shell_msgpack = msgspec.msgpack.Decoder(_Shell)
_raw_json = msgspec.json.Decoder(dict[str, Raw])
_raw_msgpack = msgspec.msgpack.Decoder(dict[str, Raw])
_to_json = msgspec.json.Encoder()
_to_msgpack = msgspec.msgpack.Encoder()
# Local names: in Python 3.11 an enum member access takes 0.1 µs.
_JSON, _CBOR, _MSGPACK = Encoding.JSON, Encoding.CBOR, Encoding.MSGPACK
_json_encode, _msgpack_encode = _to_json.encode, _to_msgpack.encode
_json_decode, _msgpack_decode = _from_json.decode, _from_msgpack.decode


def decode_request(data: bytes, encoding: Encoding) -> Request:
    """Decode one request envelope.

    :raises BadRequest: it is malformed, or has an unknown field or type.
    :raises VersionUnsupported: it requests an unsupported version.
    """
    if encoding is _CBOR:
        data = _as_msgpack(data)
        encoding = _MSGPACK
    try:
        request = _json_decode(data) if encoding is _JSON else _msgpack_decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        request = _decode_slowly(data, encoding, error)
    else:
        if request.custom is not None or request.encoding is not _JSON:
            request = _decode_slowly(data, encoding, msgspec.DecodeError("reserved field"))
    if encoding is not _JSON:
        request.encoding = encoding
    if request.timestamp is not None:
        parse_time(request.timestamp)
    if request.version is not None and request.version != VERSION:
        raise VersionUnsupported(
            f"version {request.version[:20]!r} is not supported",
            details={"supported": [VERSION]},
        )
    return request


def _as_msgpack(data: bytes) -> bytes:
    try:
        return _to_msgpack.encode(parse(data, Encoding.CBOR))
    except (RecursionError, OverflowError, TypeError) as error:
        raise BadRequest(f"not an envelope in CBOR: {error}") from None


def _decode_slowly(data: bytes, encoding: Encoding, error: Exception) -> Request:
    """Separate the `x-…` fields and decode again, or report what is wrong with the envelope."""
    if isinstance(error, RecursionError):
        raise BadRequest("the message is nested too deep") from None
    is_json = encoding is Encoding.JSON
    try:
        # A million fields would be a million objects: check the size without the body first.
        shell = (_shell_json if is_json else _shell_msgpack).decode(data)
        spare = len(data) - len(bytes(shell.body))
        if spare > _SPARE:
            raise PayloadTooLarge(
                f"the envelope has {spare} bytes besides its body; the limit is {_SPARE}",
                remedy="Put large data into the body.",
                details={"limit": _SPARE},
            )
        fields = (_raw_json if is_json else _raw_msgpack).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise BadRequest(_malformed(data, encoding, error)) from None
    custom = {k: fields.pop(k) for k in list(fields) if k.startswith("x-") and len(k) > 2}
    size = sum(len(key) + len(bytes(value)) for key, value in custom.items())
    if size > _MAX_CUSTOM:
        raise PayloadTooLarge(
            f"the x-… fields have {size} bytes; the limit is {_MAX_CUSTOM}",
            remedy="Put large data into the body; x-… fields are stored with every audit record.",
            details={"limit": _MAX_CUSTOM},
        )
    unknown = sorted(fields.keys() - _KNOWN)
    if unknown:
        raise BadRequest(
            f"unknown field {unknown[0][:60]!r} in the envelope",
            remedy="Options and values belong in `body`; custom fields are named x-<name>; "
            f"the envelope has: {', '.join(sorted(_KNOWN))}.",
            details={"unknown": unknown[:10]},
        )
    encode = _to_json.encode if is_json else _to_msgpack.encode
    try:
        decode = msgspec.json.decode if is_json else msgspec.msgpack.decode
        named = decode(fields["type"]) if "type" in fields else None
        if isinstance(named, str) and named not in get_args(RequestType):
            raise BadRequest(f"`type` must be one of {', '.join(get_args(RequestType))}")
        request = (_from_json if encoding is Encoding.JSON else _from_msgpack).decode(
            encode(fields)
        )
        if custom:
            request.custom = {k: sound(ANY.decode(v, encoding)) for k, v in custom.items()}
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        raise BadRequest(_malformed(data, encoding, cause)) from None
    return request


def _malformed(data: bytes, encoding: Encoding, error: Exception) -> str:
    if not data:
        return "the message is empty"
    return f"malformed envelope in {encoding.value}: {error}"


def peek_header(data: bytes, encoding: Encoding) -> tuple[str, str | None]:
    """Return type and id of an envelope that could not be decoded, as far as they are readable.

    Of a long message only the beginning is inspected, and only in JSON.
    """
    if len(data) > _PEEKED:
        return _peek(data[:_PEEK]) if encoding is Encoding.JSON else ("error", None)
    try:
        found = parse(data, encoding)
    except RcpError:
        text = _ID_TEXT.search(data) if encoding is Encoding.JSON else None
        return "error", text[1].decode() if text else None
    if not is_map(found):
        return "error", None
    kind, id_ = found.get("type"), found.get("id")
    type_ = kind if isinstance(kind, str) and kind in get_args(RequestType) else "error"
    return type_, (id_ if isinstance(id_, str) and len(id_) <= 128 else None)


def _peek(head: bytes) -> tuple[str, str | None]:
    """Return type and id as far as they precede any nested value."""
    ends = [place for mark in (b"{", b"[") if (place := head.find(mark, 2)) > 0]
    flat = head[: min(ends, default=len(head))]
    kind, id_ = _TYPE_TEXT.search(flat), _ID_TEXT.search(flat)
    type_ = kind[1].decode() if kind else "error"
    return type_ if type_ in get_args(RequestType) else "error", id_[1].decode() if id_ else None


def error_body(error: RcpError) -> dict[str, Any]:
    """Return the `error` object of an error."""
    body = {
        "code": error.code,
        "message": error.message,
        "origin": error.origin or "gateway",
        "path": error.path,
        "remedy": error.remedy,
        "retryable": error.retryable,
        "retry_after": error.retry_after,
        "details": error.details,
        "trace_id": error.trace_id or uuid.uuid4().hex,
    }
    return {key: value for key, value in body.items() if value is not None}


def failure(
    error: RcpError,
    type_: str,
    id_: str | None = None,
    path: str | None = None,
    *,
    command: str | None = None,
) -> Reply:
    """Return the final reply for an error."""
    if error.path is None:
        error.path = path
    return Reply(
        type=type_,
        id=id_,
        path=path,
        status=error.status,  # pyright: ignore[reportArgumentType] - each class has a legal one
        message=error.message,
        error=error_body(error),
        command=command,
        timestamp=iso(now()),
    )


def encode_reply(reply: Reply, encoding: Encoding) -> bytes:
    """Encode a reply envelope."""
    body = reply.body
    if encoding is _CBOR or reply.custom:
        return encode_frame(fields_of(reply), encode_body(body, encoding), encoding)
    encode = _json_encode if encoding is _JSON else _msgpack_encode
    if body is NO_BODY:
        return encode(reply)
    # Not by `encode_body`: this is the hot path of every request.
    raw = body.encoded(encoding) if isinstance(body, Body) else ANY.encode(body, encoding)
    reply.body = Raw(raw)
    data = encode(reply)
    reply.body = body
    return data


def encode_body(body: Any, encoding: Encoding) -> bytes:
    """Encode a reply's body; `NO_BODY` has no bytes."""
    if body is NO_BODY:
        return b""
    return body.encoded(encoding) if isinstance(body, Body) else ANY.encode(body, encoding)


def fields_of(reply: Reply) -> dict[str, Any]:
    """Return the fields of a reply to be encoded, except its body."""
    names = [name for name in reply.__struct_fields__ if name not in ("custom", "body")]
    found = {name: getattr(reply, name) for name in names}
    kept = {k: v for k, v in found.items() if v is not None and v is not False}
    return kept | (reply.custom or {})


def encode_frame(fields: dict[str, Any], body: bytes, encoding: Encoding) -> bytes:
    """Encode an envelope from its plain fields and an already encoded body, if any."""
    if encoding is Encoding.CBOR:
        head = _cbor_head(len(fields) + bool(body))
        parts = [cbor2.dumps(k) + cbor2.dumps(v) for k, v in fields.items()]
        return head + b"".join(parts) + (b"\x64body" + body if body else b"")
    whole: dict[str, Any] = {**fields, "body": Raw(body)} if body else fields
    return (_to_json if encoding is Encoding.JSON else _to_msgpack).encode(whole)


def _cbor_head(length: int) -> bytes:
    return bytes((0xA0 + length,)) if length < 24 else bytes((0xB8, length))


def check_size(data: bytes, limit: int) -> None:
    """Check that a message has at most `limit` bytes.

    :raises PayloadTooLarge: it has more.
    """
    if len(data) > limit:
        raise PayloadTooLarge(
            f"the message has {len(data)} bytes; the limit is {limit}", details={"limit": limit}
        )
