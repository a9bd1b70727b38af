"""An answer of many parts, each written as soon as it is known, and never again."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Any, TypeGuard

from rcp_kernel.sessions.session import Session
from rcp_kernel.values import Encoding, to_plain
from rcp_kernel.wire import NO_BODY, Body, Request, encode_body, encode_frame

__all__ = ["EncodedBody", "ObjectList", "expected", "is_listing", "listed"]


def expected(session: Session, request: Request) -> Encoding:
    """Return the encoding in which an answer most likely leaves."""
    return request.encoding if session.connection is None else session.connection.encoding


class EncodedBody(Body):
    """A body that is already encoded in one encoding."""

    __slots__ = ("_body", "_data", "_encoding")

    def __init__(self, body: Any, encoding: Encoding, data: bytes) -> None:
        self._body = body
        self._encoding = encoding
        self._data = data

    @property
    def value(self) -> Any:
        """The body as it was."""
        return self._body.value if isinstance(self._body, Body) else self._body

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the body as bytes of the encoding."""
        return self._data if encoding is self._encoding else encode_body(self._body, encoding)


class ObjectList(Body):
    """A list of objects; those of samples share the bytes that the samples have anyway."""

    __slots__ = ("_encoding", "_made", "_pieces", "size", "truncated")

    def __init__(self, encoding: Encoding) -> None:
        self._encoding = encoding
        self._made: list[tuple[dict[str, Any] | None, Any]] = []
        self._pieces: list[bytes] = []
        self.size = 1
        """Bytes of all parts, and of the list itself."""
        self.truncated = False

    @property
    def last(self) -> Any:
        """The last part without further fields."""
        return self._made[-1][1]

    def __len__(self) -> int:
        return len(self._pieces)

    def add(self, fields: dict[str, Any] | None, body: Any, longest: int | None = None) -> bool:
        """Add an object of plain fields and a `body`; return whether it fitted.

        Without fields the body is the whole object.

        :raises RcpError: the body cannot be encoded.
        """
        data = encode_body(body, self._encoding)
        if longest is not None and self.size + len(data) > longest:
            return False
        piece = data if fields is None else encode_frame(fields, data, self._encoding)
        if longest is not None and self.size + len(piece) >= longest:
            return False
        self._pieces.append(piece)
        self._made.append((fields, body))
        self.size += len(piece) + 1  # and a comma
        return True

    @property
    def value(self) -> list[dict[str, Any]]:
        """The parts as plain data."""
        return [_object(fields, body) for fields, body in self._made]

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the list as bytes of the encoding."""
        pieces = self._pieces
        if encoding is not self._encoding:
            pieces = [_piece(fields, body, encoding) for fields, body in self._made]
        if encoding is Encoding.JSON:
            return b"[%b]" % b",".join(pieces)
        return b"".join((_head(len(pieces), encoding), *pieces))


def is_listing(value: Any) -> TypeGuard[Iterator[Body | None]]:
    """Return whether a value is a list yet to be encoded by `listed`."""
    return isinstance(value, Iterator)


def listed(
    items: Iterator[Any], encoding: Encoding, longest: int, most: int | None = None
) -> Generator[None, None, ObjectList]:
    """Encode a list in steps, as far as it fits; None stands for an item that is skipped."""
    page = ObjectList(encoding)
    for item in items:
        if item is not None:
            full = len(page) == most
            if full or not page.add(None, item, longest if len(page) else None):
                page.truncated = True
                break
        yield
    return page


def _piece(fields: dict[str, Any] | None, body: Any, encoding: Encoding) -> bytes:
    data = encode_body(body, encoding)
    return data if fields is None else encode_frame(fields, data, encoding)


def _object(fields: dict[str, Any] | None, body: Any) -> Any:
    if fields is None:
        return _plain(body)
    return fields if body is NO_BODY else {**fields, "body": _plain(body)}


def _plain(body: Any) -> Any:
    return to_plain(body.value if isinstance(body, Body) else body)


def _head(length: int, encoding: Encoding) -> bytes:
    """Write the head of a list: MessagePack's array, or CBOR's major type 4."""
    few, small, short, long = (
        (0x90, None, 0xDC, 0xDD) if encoding is Encoding.MSGPACK else (0x80, 0x98, 0x99, 0x9A)
    )
    if length < (16 if small is None else 24):
        return bytes((few | length,))
    if small is not None and length < 0x100:
        return bytes((small, length))
    if length < 0x10000:
        return bytes((short,)) + length.to_bytes(2, "big")
    return bytes((long,)) + length.to_bytes(4, "big")
