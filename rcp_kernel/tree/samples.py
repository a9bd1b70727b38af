"""One value of a resource, checked once and encoded once, however many are to receive it."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import suppress
from typing import Any, Literal, Protocol

import msgspec

from rcp_conditions.fields import Field
from rcp_kernel.clock import iso, iso_bytes
from rcp_kernel.errors import DeviceRejected, Overrun, RcpError
from rcp_kernel.spi import Encoded, Native
from rcp_kernel.values import ANY, Encoding, ValueType, is_long, to_plain, value_type
from rcp_kernel.wire import Body, encode_frame
from rcp_protocol.plain import is_map

__all__ = [
    "NATIVE",
    "Fields",
    "Listener",
    "Rendering",
    "Sample",
    "form_of",
    "forms",
    "masked",
    "project",
]

NATIVE = ("encoding: native",)
"""In place of the fields of a projection: the backend's own bytes."""

_BYTES = value_type(bytes)
_to_json = msgspec.json.Encoder().encode
_JSON = Encoding.JSON  # Python 3.11 takes 0.1 µs to look it up in the enum
_BODIES = {encoding: f"body in {encoding}" for encoding in Encoding}
"""Keys of bodies among a sample's encodings."""
Form = Literal["value", "native", "encoded"]
forms: dict[type, Form] = {}
"""Which protocol values of a type follow: asking the protocol itself takes 8 µs."""


def form_of(value: Any) -> Form:
    """Find out the form of a type's first value; callers look at `forms` first."""
    form: Form = "native" if isinstance(value, Native) else "value"
    form = forms[type(value)] = "encoded" if isinstance(value, Encoded) else form
    return form


class Rendering:
    """How an adapter writes the updates of a subscription, in place of the protocol's envelope.

    An update is `head` and what `tail` returns for its sample. The bytes of `tail` are shared by all
    subscriptions with the same function, whole frames by those with the same rendering: create few
    of both. `tail` raises `RcpError` for a sample that is not sent.

    `write_interval`: least time in seconds between two writes of a path's updates. Earlier updates
    are batched, up to half a queue, into one write; a slower path is not delayed.
    """

    __slots__ = ("__weakref__", "head", "tail", "write_interval")

    def __init__(
        self, head: bytes, tail: Callable[[Sample], bytes], *, write_interval: float = 0.0
    ) -> None:
        self.head = head
        self.tail = tail
        self.write_interval = write_interval


Fields = tuple[str, ...] | Rendering | None
"""A projection, or what is sent in place of the envelope; None: the whole value."""


class Publisher(Protocol):
    """The backend that published a sample."""

    @property
    def name(self) -> str:
        """The backend's name in the configuration."""
        ...

    def fault(self, detail: str) -> None:
        """Note a fault of the backend's own making."""
        ...


class Source(Protocol):
    """The resource that a sample is of."""

    @property
    def path(self) -> str:
        """Its place in the tree."""
        ...

    @property
    def value_type(self) -> ValueType:
        """Validates and encodes its values."""
        ...

    @property
    def owner(self) -> Publisher:
        """Who answers for its values."""
        ...


class Sample(Body):
    """A value with its times and number; encoded on first use.

    Any method that needs the value raises `DeviceRejected` if it does not match the resource's
    type: an invalid value is the robot's fault and is never delivered.
    """

    __slots__ = (
        "_checked",
        "_encoding",
        "_json",
        "_time",
        "_value",
        "encodings",
        "entry",
        "json_piece",
        "json_tail",
        "native",
        "received",
        "seq",
        "timestamp",
    )

    def __init__(
        self,
        entry: Source,
        value: Any,
        timestamp: int,
        received: int,
        seq: int,
        form: Form = "value",
    ) -> None:
        self.entry = entry
        self.timestamp = timestamp
        """Source time, ns since the epoch."""
        self.received = received
        self.seq = seq
        self.native: Native | None = None if form == "value" else value
        """The backend's own form of the value."""
        self._encoding: Encoding | None = value.encoding if form == "encoded" else None
        """Of the bytes of `native`, where they are the value in an encoding."""
        self._value = value
        self._checked = False
        self._time: str | None = None
        self._json: bytes | None = None
        self.json_tail: bytes | None = None
        """The tail in JSON, if it was made."""
        self.json_piece: bytes | None = None
        """What all JSON replies to a read share, if it was made."""
        self.encodings: dict[Any, bytes] = {}
        """The other encodings made so far: tails by encoding, or encoding and fields."""

    @property
    def time(self) -> str:
        """Source time as text."""
        return self._time or self._format_time()

    def _format_time(self) -> str:
        try:
            text = iso(self.timestamp)
        except Exception as error:  # a robot's clock is as trustworthy as its values
            self._fault(error)
            text = iso(self.received)
        self._time = text
        return text

    @property
    def value(self) -> Any:
        """The typed value, validated."""
        if not self._checked:
            self._check()
        return self._value

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the value as bytes of the encoding."""
        if self._encoding is encoding and self.native is not None:
            return self.native.data
        if not self._checked:
            self._check()
        body = self._json if encoding is _JSON else self.encodings.get(_BODIES[encoding])
        if body is None:
            try:
                body = self.entry.value_type.encode(self._value, encoding)
            except Exception as error:
                raise self._fault(error) from error
            if encoding is _JSON:
                self._json = body
            else:
                self.encodings[_BODIES[encoding]] = body
        return body

    def encode_in_steps(self) -> Generator[None]:
        """Validate a long value and encode it as JSON, in steps."""
        if not self._checked and self.native is None:
            try:
                value, json = yield from self.entry.value_type.check_in_steps(self._value)
            except Exception:  # readers of the value get the error
                return
            if not self._checked:
                self._value, self._json, self._checked = value, json, True

    def projected(self, encoding: Encoding, fields: tuple[str, ...]) -> bytes:
        """Return only some fields of the value as bytes of the encoding."""
        value = self.value
        key = (_BODIES[encoding], fields)
        body = self.encodings.get(key)
        if body is None:
            try:
                body = ANY.encode(project(value, fields), encoding)
            except Exception as error:
                raise self._fault(error) from error
            self.encodings[key] = body
        return body

    def tail(self, encoding: Encoding, fields: Fields = None) -> bytes:
        """Return the part of an update that all its receivers share, to be spliced to its head."""
        if type(fields) is Rendering:
            return self._rendered(encoding, fields)
        if fields is None and encoding is _JSON:
            tail = self.json_tail
            if tail is None:
                if not self._checked and self.native is None:
                    self._check()
                tail = self.json_tail = self._splice(_JSON, self._json or self.encoded(_JSON))
            return tail
        assert not isinstance(fields, Rendering)
        key = encoding if fields is None else (encoding, fields)
        tail = self.encodings.get(key)
        if tail is None:
            if fields is None:
                body = self.encoded(encoding)
            elif fields is NATIVE:
                body = self._serialised(encoding)
            else:
                body = self.projected(encoding, fields)
            tail = self.encodings[key] = self._splice(encoding, body)
        return tail

    def release(self) -> None:
        """Drop the encodings; they are made again on use."""
        self._json = self.json_tail = self.json_piece = None
        if self.encodings:
            self.encodings.clear()

    def _rendered(self, encoding: Encoding, rendering: Rendering) -> bytes:
        key = (encoding, rendering.tail)
        tail = self.encodings.get(key)
        if tail is None:
            tail = self.encodings[key] = rendering.tail(self)
        return tail

    def _serialised(self, encoding: Encoding) -> bytes:
        if self.native is None:
            raise Overrun("the sample has no native form")
        return _BYTES.encode(bytes(self.native.data), encoding)

    def length(self, encoding: Encoding, fields: Fields) -> int:
        """Return how many bytes the value has in an update."""
        if isinstance(fields, Rendering):
            return len(self._rendered(encoding, fields))
        if fields is None:
            return len(self.encoded(encoding))
        if fields is NATIVE:
            return 0 if self.native is None else len(self.native.data)
        return len(self.projected(encoding, fields))

    def read_piece(self) -> bytes:
        """Return what all JSON replies to a read of this sample share, from path to state.

        It is written by hand for speed: a field added to `Reply` for reads is added here as well.
        """
        piece = self.json_piece = (
            b',"path":"%b","status":"completed","body":%b,"seq":%d,"source_timestamp":"%b","state":"'
        ) % (
            self.entry.path.encode(),
            self.encoded(_JSON),
            self.seq,
            self.time.encode(),
        )
        return piece

    def _splice(self, encoding: Encoding, body: bytes) -> bytes:
        if encoding is _JSON:
            try:
                time = iso_bytes(self.timestamp)
            except Exception:  # `time` reports the fault, and uses the time of arrival
                time = self.time.encode()
            seq = _to_json(self.seq)
            return b"".join((b'"seq":', seq, b',"timestamp":"', time, b'","body":', body, b"}"))
        facts = encode_frame({"seq": self.seq, "timestamp": self.time}, b"", encoding)
        key = b"\xa4body" if encoding is Encoding.MSGPACK else b"\x64body"
        return b"".join((facts[1:], key, body))  # without the map's own head

    @property
    def encoded_size(self) -> int:
        """Length of its longest encoding in bytes; 0: none was made."""
        return max(map(len, (self.json_tail or b"", *self.encodings.values())))

    def memory_size(self) -> int:
        """Estimate the memory of the value in bytes."""
        if self.native is not None:
            return len(self.native.data)
        if not self._checked and is_long(self._value):
            with suppress(Exception):  # `encoded` says why; it checks the value, which takes longer
                return len(msgspec.msgpack.encode(self._value))
        return len(self.encoded(Encoding.MSGPACK))

    def _check(self) -> None:
        try:
            if self.native is not None:
                self._value = self.native.decode()
            else:
                self._value, self._json = self.entry.value_type.check(self._value)
        except Exception as error:
            raise self._fault(error) from error
        self._checked = True

    def _fault(self, error: Exception) -> DeviceRejected:
        why = error.message if isinstance(error, RcpError) else f"{type(error).__name__}: {error}"
        fault = DeviceRejected(
            f"backend '{self.entry.owner.name}' published a value that does not match the type of "
            f"{self.entry.path}: {why}",
            path=self.entry.path,
            origin=self.entry.owner.name,
            remedy="Correct the backend or the type it declares. The value was not delivered.",
        )
        self.entry.owner.fault(fault.message)
        return fault


class Listener(Protocol):
    """A receiver of a resource's samples."""

    def offer(self, sample: Sample) -> None:
        """Handle a new sample; must neither block nor raise."""
        ...


def masked(sample: Sample, shown: Callable[[Any], Any]) -> Sample | None:
    """Return a sample with the visible part of its value; None if nothing is visible."""
    value = sample.value
    masked = shown(value)
    if masked is None or masked is value:
        return None if masked is None else sample
    return Sample(sample.entry, masked, sample.timestamp, sample.received, sample.seq)


def project(value: Any, fields: tuple[str, ...]) -> dict[str, Any]:
    """Keep only some fields, nested as they were: `position.x` gives `{"position": {"x": …}}`."""
    out: dict[str, Any] = {}
    for dotted in fields:
        field = Field(dotted).one(value)
        names = dotted.split(".")
        place = out
        for name in names[:-1]:
            inner = place.setdefault(name, {})
            if not is_map(inner):  # the whole of it was selected as well
                break
            place = inner
        else:
            place[names[-1]] = to_plain(field)
    return out
