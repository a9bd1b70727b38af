"""The binary messages: all integers little-endian, the first byte says what it is."""

from __future__ import annotations

import struct
from math import isfinite
from typing import NamedTuple

from rcp_kernel.errors import BadRequest

__all__ = [
    "Call",
    "Control",
    "Message",
    "asset",
    "asset_failure",
    "call_response",
    "decode_frame",
    "is_binary",
    "message_head",
    "playback_state",
    "time_frame",
]

_CHANNEL = struct.Struct("<BI")
_CALL = struct.Struct("<BIII")
_ASSET = struct.Struct("<BIBI")
_TIME = struct.Struct("<BQ")
_CONTROL = struct.Struct("<BBfBQI")
_STATE = struct.Struct("<BBQfBI")
_MESSAGE_DATA, _TIME_DATA, _CALL_RESPONSE, _ASSET_RESPONSE, _PLAYBACK_STATE = 1, 2, 3, 4, 5
_CLIENT_MESSAGE, _CLIENT_CALL, _CLIENT_CONTROL = 1, 2, 3
_PLAY, _PAUSE = 0, 1
_LONGEST_ID = 256
_WHITE = b" \t\r\n"  # how a JSON text may begin besides `{`


class Message(NamedTuple):
    """What a client publishes on one of its channels."""

    channel: int
    payload: bytes


class Call(NamedTuple):
    """A call of a service."""

    service: int
    id: int
    encoding: str
    payload: bytes


class Control(NamedTuple):
    """What a client wants of a replay."""

    paused: bool
    speed: float
    seek: int | None
    """The recording's time to go to, ns."""
    id: str


def is_binary(data: bytes) -> bool:
    """Return whether a message is binary: JSON never begins with an opcode."""
    return data[:1] < b" " and data[:1] not in _WHITE if data else False


def decode_frame(data: bytes) -> Message | Call | Control:
    """Decode a binary message of a client.

    :raises BadRequest: it is truncated, or has an unknown opcode.
    """
    opcode = data[0]
    try:
        if opcode == _CLIENT_MESSAGE:
            return Message(_CHANNEL.unpack_from(data)[1], data[_CHANNEL.size :])
        if opcode == _CLIENT_CALL:
            _, service, id_, length = _CALL.unpack_from(data)
            end = _CALL.size + length
            if length > 64 or len(data) < end:
                raise BadRequest("the encoding of a service call is truncated or too long")
            return Call(service, id_, data[_CALL.size : end].decode(), data[end:])
        if opcode == _CLIENT_CONTROL:
            return _control(data)
    except (struct.error, UnicodeDecodeError):
        raise BadRequest(f"a binary message of {len(data)} bytes is truncated") from None
    raise BadRequest(f"{opcode} is not an opcode of a binary message")


def _control(data: bytes) -> Control:
    _, command, speed, seeks, moment, length = _CONTROL.unpack_from(data)
    id_ = data[_CONTROL.size : _CONTROL.size + length]
    if command not in (_PLAY, _PAUSE) or len(id_) < length or length > _LONGEST_ID:
        raise BadRequest("a playback control request is truncated or has an unknown command")
    if not isfinite(speed):
        raise BadRequest(f"{speed} is not a speed of playback")
    return Control(command == _PAUSE, speed, moment if seeks else None, id_.decode())


def message_head(subscription: int) -> bytes:
    """Return the start of a message: what follows is its time and its payload."""
    return _CHANNEL.pack(_MESSAGE_DATA, subscription)


def time_frame(nanoseconds: int) -> bytes:
    """Return a message with the time."""
    return _TIME.pack(_TIME_DATA, nanoseconds)


def playback_state(status: int, moment: int, speed: float, *, seeked: bool, id_: str) -> bytes:
    """Return where a replay is; with the id of the request that this is the answer to."""
    text = id_.encode()
    return _STATE.pack(_PLAYBACK_STATE, status, moment, speed, seeked, len(text)) + text


def call_response(call: Call, payload: bytes) -> bytes:
    """Return the response to a call, in its encoding."""
    encoding = call.encoding.encode()
    head = _CALL.pack(_CALL_RESPONSE, call.service, call.id, len(encoding))
    return b"".join((head, encoding, payload))


def asset(request: int, data: bytes) -> bytes:
    """Return a file."""
    return _ASSET.pack(_ASSET_RESPONSE, request, 0, 0) + data


def asset_failure(request: int, reason: str) -> bytes:
    """Return why there is no such file."""
    text = reason.encode()
    return _ASSET.pack(_ASSET_RESPONSE, request, 1, len(text)) + text
