"""Segments of a long message, as the contract defines them (section 6).

Every segment carries the size and hash of the whole, so that the receiver can allocate memory,
detect damage, and request missing segments.
"""

from __future__ import annotations

import base64
import hashlib
import re
from typing import Annotated, Any, Literal

import cbor2
import msgspec
from msgspec import Meta

from rcp_kernel.errors import BadRequest
from rcp_kernel.values import Encoding, parse

__all__ = ["Again", "Segment", "cut", "frame", "read", "request_again"]

TransferId = Annotated[str, Meta(min_length=1, max_length=128)] | int


class Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One part of a transfer."""

    type: Literal["segment"]
    id: TransferId
    num: Annotated[int, Meta(ge=0)]
    total: Annotated[int, Meta(ge=1)]
    size: Annotated[int, Meta(ge=0)]
    """Size of the whole message."""
    sha256: Annotated[str, Meta(pattern="^[0-9a-fA-F]{64}$")]
    """Hash of the whole message."""
    body: bytes


class Again(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request for segments that did not arrive."""

    type: Literal["segment"]
    id: TransferId
    resend: list[Annotated[int, Meta(ge=0)]]


class _Shell(msgspec.Struct):
    """What tells a segment from another message; the rest is skipped, and no object made of it."""

    type: msgspec.Raw = msgspec.Raw()
    resend: msgspec.Raw = msgspec.Raw()


_NAMES = (b'"segment"', b"\xa7segment")  # in JSON and in MessagePack
_CBOR = re.compile(rb"(?:d|x\x04)type(?:g|x\x07)segment")
"""The field `type` of a segment in CBOR, which cannot be read without the rest."""
_from_json = msgspec.json.Decoder(Segment)
_again_json = msgspec.json.Decoder(Again)
_from_msgpack = msgspec.msgpack.Decoder(Segment)
_again_msgpack = msgspec.msgpack.Decoder(Again)
_shell_json = msgspec.json.Decoder(_Shell)
_shell_msgpack = msgspec.msgpack.Decoder(_Shell)


def read(data: bytes, encoding: Encoding) -> Segment | Again | None:
    """Parse a segment, or a request for segments; None if the message is something else.

    :raises BadRequest: it is a malformed segment.
    """
    if encoding is Encoding.CBOR:
        return _read_cbor(data) if _CBOR.search(data) else None
    is_json = encoding is Encoding.JSON
    try:
        return (_from_json if is_json else _from_msgpack).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        fault = error
    try:
        shell = (_shell_json if is_json else _shell_msgpack).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None  # the gateway reports the error
    if bytes(shell.type) not in _NAMES:
        return None
    if not bytes(shell.resend):
        raise _malformed(fault)
    try:
        return (_again_json if is_json else _again_msgpack).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _malformed(error) from None


def _read_cbor(data: bytes) -> Segment | Again | None:
    try:
        plain = parse(data, Encoding.CBOR)
    except BadRequest:
        return None  # the gateway reports the error
    if not isinstance(plain, dict) or plain.get("type") != "segment":
        return None
    try:
        return msgspec.convert(plain, Again if "resend" in plain else Segment)
    except msgspec.ValidationError as error:
        raise _malformed(error) from None


def _malformed(error: Exception) -> BadRequest:
    return BadRequest(
        f"malformed segment: {error}",
        remedy="Send type, id, num, total, size, sha256 and body; or id and resend.",
    )


def cut(data: bytes, size: int) -> list[bytes]:
    """Split a message into bodies of at most `size` bytes."""
    return [data[start : start + size] for start in range(0, len(data), size)]


def frame(
    id_: str, num: int, bodies: list[bytes], whole: tuple[int, str], encoding: Encoding
) -> bytes:
    """Encode one segment; `whole` is size and hash of the message."""
    fields: dict[str, Any] = {
        "type": "segment",
        "id": id_,
        "num": num,
        "total": len(bodies),
        "size": whole[0],
        "sha256": whole[1],
        "body": bodies[num],
    }
    return _encode(fields, encoding)


def request_again(id_: str | int, missing: list[int], encoding: Encoding) -> bytes:
    """Encode a request for segments."""
    return _encode({"type": "segment", "id": id_, "resend": missing}, encoding)


def _encode(fields: dict[str, Any], encoding: Encoding) -> bytes:
    if encoding is Encoding.CBOR:
        return cbor2.dumps(fields)
    if encoding is Encoding.MSGPACK:
        return msgspec.msgpack.encode(fields)
    if (body := fields.get("body")) is not None:
        fields["body"] = base64.b64encode(body).decode()
    return msgspec.json.encode(fields)


def digest(data: bytes) -> str:
    """Return the hash used in segments."""
    return hashlib.sha256(data).hexdigest()
