"""The number of values in a message, counted before it is decoded.

The cost of a message depends on its values, not on its bytes: 16 MB may be one image or five
million lists. Counting runs in steps, so that it does not block the event loop either.
"""

from __future__ import annotations

from collections.abc import Generator

from rcp_protocol.errors import PayloadTooLarge
from rcp_protocol.values import Encoding

__all__ = ["LONG", "check_structure"]

LONG = 16_384  # bytes: in a shorter message there is nothing to count
_TEXT = 3  # numbers that cost as much as one text
_NEST = 9  # or as one list or map, or an integer that JSON carries as a text
_CBOR = 4  # of them cost as much as one in CBOR, which is translated into MessagePack
_STEP = 65_536  # bytes of JSON in one step
_TOKENS = 1024  # tokens per step, for encodings that are scanned one by one
_DIGITS = bytes.maketrans(b"0123456789-:[ \t\r\n", b"0" * 10 + b"," * 7)
_WIDE = b"," + b"0" * 16
_DROPPED = bytes(set(range(256)) - set(b',[{"'))


def check_structure(data: bytes, encoding: Encoding, limit: int) -> Generator[None]:
    """Refuse a message with more values than `limit`; a string counts as 3, a list as 9.

    An integer of more than 15 digits also counts as 9. In CBOR everything counts fourfold. A
    malformed message may pass: decoding it reports the error.

    :raises PayloadTooLarge: it has more.
    """
    times = 1
    match encoding:
        case Encoding.JSON:
            counting = _json(data)
        case Encoding.MSGPACK:
            counting = _tokens(data, _MSGPACK, _MSGPACK_NESTS)
        case Encoding.CBOR:
            counting, times = _tokens(data, _CBOR_TOKENS, _CBOR_NESTS), _CBOR
    count = 1
    for some in counting:
        count += some * times
        if count > limit:
            raise PayloadTooLarge(
                f"the message has more than {limit} values; a text counts for {_TEXT}, "
                f"a list, a map or a long integer for {_NEST}{', and all fourfold in CBOR' if times > 1 else ''}",
                remedy="Send long lists of numbers as bytes or in several messages, or have "
                "`[limits] values` raised.",
                details={"limit": limit},
            )
        yield


def _json(data: bytes) -> Generator[int]:
    """Count by commas, quotes and brackets, without those within texts."""
    rest, inside = b"", False
    for start in range(0, len(data), _STEP):
        part = rest + data[start : start + _STEP]
        if b"\\" in part:
            part = part.replace(b"\\\\", b"").replace(b'\\"', b"")
        rest = b"\\" if part.endswith(b"\\") else b""  # the other half is in the next part
        marks = part.translate(None, _DROPPED)
        quotes = marks.count(b'"')
        if quotes:
            texts = marks.split(b'"')
            marks = b"".join(texts[inside::2])
            inside ^= quotes % 2 == 1
        elif inside:
            marks = b""
        nests = marks.count(b"[") + marks.count(b"{") + part.translate(_DIGITS).count(_WIDE)
        yield len(marks) + (_NEST - 1) * nests + quotes * (_TEXT - 1) // 2


Token = tuple[int, int, int]
"""Weight of a token, number of bytes after the first, and number of those that give a length."""


def _tokens(data: bytes, kinds: list[Token], nests: bytes) -> Generator[int]:
    """Count the tokens of an encoding in which the first byte defines each token.

    Ends where only nested lists follow: no decoder accepts that depth.
    """
    place, end = 0, len(data)
    while place < end:
        if len(run := data[place : place + _TOKENS]) == _TOKENS and not run.translate(None, nests):
            return
        count = 0
        for _ in range(_TOKENS):
            if place >= end:
                break
            worth, follow, width = kinds[data[place]]
            count += worth
            place += 1
            if width:
                follow += int.from_bytes(data[place : place + width])
            place += width + follow
        yield count


def _msgpack_token(lead: int) -> Token:
    match lead:
        case _ if 0x80 <= lead <= 0x9F:
            return _NEST, 0, 0
        case _ if 0xA0 <= lead <= 0xBF:
            return _TEXT, lead & 31, 0
        case 0xC4 | 0xC5 | 0xC6:
            return _TEXT, 0, 1 << (lead - 0xC4)
        case 0xC7 | 0xC8 | 0xC9:
            return _TEXT, 1, 1 << (lead - 0xC7)
        case 0xCA | 0xCB:
            return 1, 4 << (lead - 0xCA), 0
        case 0xCF | 0xD3:
            return _NEST, 8, 0
        case _ if 0xCC <= lead <= 0xD3:
            return 1, 1 << (lead & 3), 0
        case _ if 0xD4 <= lead <= 0xD8:
            return _TEXT, 1 + (1 << (lead - 0xD4)), 0
        case 0xD9 | 0xDA | 0xDB:
            return _TEXT, 0, 1 << (lead - 0xD9)
        case 0xDC | 0xDD | 0xDE | 0xDF:
            return _NEST, 2 << (lead & 1), 0
        case _:
            return 1, 0, 0


def _cbor_token(lead: int) -> Token:
    major, info = lead >> 5, lead & 31
    width = 1 << (info - 24) if 24 <= info <= 27 else 0
    match major:
        case 2 | 3:
            return _TEXT, info if info < 24 else 0, width
        case 4 | 5:
            return _NEST, width, 0
        case 0 | 1 if width == 8:
            return _NEST, 8, 0
        case _:
            return 1, width, 0


_MSGPACK_NESTS = bytes((*range(0x81, 0x90), *range(0x91, 0xA0)))
"""First bytes of non-empty lists and maps that contain their own size."""
_CBOR_NESTS = bytes((*range(0x81, 0x98), *range(0xA1, 0xB8)))
_MSGPACK = [_msgpack_token(lead) for lead in range(256)]
_CBOR_TOKENS = [_cbor_token(lead) for lead in range(256)]
