"""The gateway's messages as the client's user sees them, and their encodings."""

from __future__ import annotations

from typing import Any

import cbor2
import msgspec

from rcp_protocol.values import Encoding, dump, parse

__all__ = ["Codec", "Message", "Notice", "Reply", "ResourceInfo", "Update"]


class Reply(msgspec.Struct, kw_only=True, omit_defaults=True):
    """One reply envelope of the gateway."""

    type: str
    id: str | None = None
    path: str | None = None
    status: str = ""
    body: Any = None
    message: str | None = None
    error: dict[str, Any] | None = None
    command: str | None = None
    progress: float | None = None
    """Completed fraction, 0 to 1."""
    seq: int | None = None
    timestamp: str | None = None
    """When the gateway wrote the reply."""
    source_timestamp: str | None = None
    """When the source measured the value of a read."""
    state: str | None = None
    """`fresh` or `stale`, for the value of a read."""
    truncated: bool = False
    """Whether `body` is incomplete; `cursor` continues it."""
    cursor: str | None = None
    dry_run: bool = False


class Message(Reply, kw_only=True):
    """Any envelope of the gateway: a reply with the fields of updates, notices and segments."""

    code: str | None = None
    dropped: int = 0
    native_type: str | None = None
    num: int | None = None
    total: int | None = None
    size: int | None = None
    sha256: str | None = None


class Update(msgspec.Struct, kw_only=True, omit_defaults=True):
    """One sample of a subscription."""

    path: str
    seq: int
    """Sequence number of the sample within its resource, incremented by 1."""
    timestamp: str
    """When the source measured it."""
    body: Any = None
    dropped: int = 0
    """Samples of this path skipped since the last update, because the client is too slow."""
    truncated: bool = False
    """Whether the value is too long for a pattern subscription: `body` is None. Read the path, or
    subscribe to it by name."""
    size: int | None = None
    """Size of a truncated value in the connection's encoding, bytes."""
    native_type: str | None = None
    """Name of the backend's own type, in the first update of a native subscription."""


class Notice(msgspec.Struct, kw_only=True, omit_defaults=True):
    """An unsolicited message: from the gateway, or from the client about its connection."""

    code: str
    """`gap`, `dropped`, `stale`, `disconnected`, `reconnected`, …"""
    message: str | None = None
    path: str | None = None
    id: str | None = None
    """The subscription concerned, if any."""
    facts: dict[str, Any] = {}
    """The other fields: `lost`, `first`, `last`, `reason`, …"""


class ResourceInfo(msgspec.Struct, kw_only=True, omit_defaults=True):
    """One resource as in the catalogue."""

    path: str
    kind: str
    operations: list[str]
    offers: list[str] | None = None
    """All its operations, also those that the caller may not use, if `discover` asked for them."""
    description: str = ""
    schemas: dict[str, dict[str, Any]] = {}
    """JSON Schemas: `value`, or `input`, `output` and `feedback` of an action or service."""
    schema_ids: dict[str, str] = {}
    examples: list[Any] = []
    unit: str | None = None
    state: str | None = None
    backend: str | None = None
    deadline: float | None = None
    """Seconds without an update after which a value counts as stale."""
    timeout: float | None = None
    policy: str | None = None
    max_age: float | None = None
    valid_for: float | None = None
    safe: Any = None
    moves: bool | None = None
    """Whether it may move something, if its kind does not tell: actuators and actions may."""
    energises: bool = False
    """Whether it arms the robot or applies torque."""
    atomic: str | None = None
    """The group of resources of its robot that can be written as one (`Client.write_all`)."""
    native: str | None = None
    meta: dict[str, Any] = {}
    profiles: list[str] = []
    """The profiles of its robot that it is part of: `name/version`."""
    frames: list[str] = []
    """The frames to which its values, or from which its goals, are converted."""


_ENVELOPE = frozenset(("type", "code", "message", "path", "id", "timestamp"))


class Codec:
    """Encodes and decodes envelopes in one encoding."""

    def __init__(self, encoding: Encoding) -> None:
        self.encoding = encoding
        self.subprotocol = f"rcp.v1.{encoding.value}"
        self.is_text = encoding is Encoding.JSON
        self._json = msgspec.json.Decoder(Message)
        self._msgpack = msgspec.msgpack.Decoder(Message)

    def encode(self, envelope: dict[str, Any]) -> bytes:
        """Encode an envelope.

        :raises InvalidValue: its body has an integer that no encoding supports.
        """
        return dump(envelope, self.encoding)

    def decode(self, data: bytes) -> Message:
        """Decode an envelope of the gateway.

        :raises ValueError: it is not an envelope.
        """
        if self.encoding is Encoding.MSGPACK:
            return self._msgpack.decode(data)
        if self.encoding is Encoding.JSON:
            return self._json.decode(data)
        try:
            return msgspec.convert(cbor2.loads(data), Message)
        except cbor2.CBORDecodeError as error:
            raise ValueError(str(error)) from error

    def notice(self, data: bytes) -> Notice:
        """Decode an envelope as a notice, with all its facts."""
        plain = parse(data, self.encoding)
        return Notice(
            code=plain.get("code", "?"),
            message=plain.get("message"),
            path=plain.get("path"),
            id=plain.get("id"),
            facts={key: item for key, item in plain.items() if key not in _ENVELOPE},
        )
