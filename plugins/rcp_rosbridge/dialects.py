"""How the messages of a topic are written: in JSON, in CBOR, or as the robot's own bytes in CBOR."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Literal
from weakref import WeakValueDictionary

import msgspec

from rcp_gateway.api import Rendering, Sample, to_internal_error
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.values import to_plain
from rcp_ros_messages import Source, encode_cdr, message_type, time_of
from rcp_rosbridge.cbor import cbor_head, to_cbor
from rcp_rosbridge.graph import Feed, RosTopic

__all__ = ["Dialect", "Renderings", "binary"]

Dialect = Literal["json", "cbor", "cbor-raw"]
_encode = msgspec.json.Encoder().encode


def binary(dialect: Dialect) -> bool:
    """Return whether messages are binary."""
    return dialect != "json"


class _Nothing(RcpError):
    """The value is part of another message."""

    code = "internal"


class Renderings:
    """The renderings of all topics, shared by all clients: a message is written once for each."""

    def __init__(self, write_interval: float) -> None:
        self._write_interval = write_interval
        self._known: WeakValueDictionary[Any, Rendering] = WeakValueDictionary()
        self._beside: WeakValueDictionary[str, _Newest] = WeakValueDictionary()

    def of(self, topic: RosTopic, feed: Feed, dialect: Dialect, mark: bytes = b"") -> Rendering:
        """Return the rendering of a topic's feed; `mark` is what each message begins with."""
        key = (topic.name, topic.type, feed.path, feed.beside, feed.wraps, dialect, mark)
        found = self._known.get(key)
        if found is None:
            messages = _Messages(topic.type, feed, self._newest(feed))
            if dialect == "json":
                head = b'{"op":"publish","topic":' + _encode(topic.name) + b',"msg":'
                tail = messages.json
            else:
                head = cbor_head(topic.name)
                tail = messages.cbor if dialect == "cbor" else messages.raw
            found = Rendering(mark + head, tail, write_interval=self._write_interval)
            self._known[key] = found
        return found

    def companion(self, feed: Feed) -> Rendering | None:
        """Return the rendering of the resource beside a feed: its values are kept, and not sent."""
        newest = self._newest(feed)
        return None if newest is None else newest.rendering

    def _newest(self, feed: Feed) -> _Newest | None:
        if feed.beside is None:
            return None
        found = self._beside.get(feed.beside)
        if found is None:
            found = self._beside[feed.beside] = _Newest()
        return found


class _Newest:
    """The newest value of a resource, for messages of another one."""

    def __init__(self) -> None:
        self.value: Any = None
        self.rendering = Rendering(b"", self._keep)

    def _keep(self, sample: Sample) -> bytes:
        self.value = to_plain(sample.value)
        raise _Nothing("kept")


class _Messages:
    """Makes the messages of a feed."""

    def __init__(self, type_: str, feed: Feed, newest: _Newest | None) -> None:
        self._type = type_
        self._feed = feed
        self._newest = newest
        self._known = message_type(type_) is not None

    def json(self, sample: Sample) -> bytes:
        """Return a message in JSON, up to the end of the operation."""
        return self._contained(sample, self._json)

    def cbor(self, sample: Sample) -> bytes:
        """Return a message in CBOR."""
        return self._contained(sample, self._cbor)

    def raw(self, sample: Sample) -> bytes:
        """Return the serialised message and its time, in CBOR."""
        return self._contained(sample, self._raw)

    def _contained(self, sample: Sample, make: Callable[[Sample], bytes]) -> bytes:
        try:
            return make(sample)
        except RcpError:
            raise
        except Exception as error:
            raise to_internal_error(error, path=sample.entry.path) from None

    def _json(self, sample: Sample) -> bytes:
        feed = self._feed
        if feed.mapping is None and not feed.wraps:
            return _encode(sample.value) + b"}"
        return _encode(self._message(sample)) + b"}"

    def _cbor(self, sample: Sample) -> bytes:
        return to_cbor(self._message(sample), self._type)

    def _raw(self, sample: Sample) -> bytes:
        data = self._serialised(sample)
        secs, nsecs = divmod(max(0, sample.timestamp), 1_000_000_000)
        head = b"\xa3\x64secs" + _unsigned(secs) + b"\x65nsecs" + _unsigned(nsecs)
        return b"".join((head, b"\x65bytes\x5a", struct.pack(">I", len(data)), data))

    def _serialised(self, sample: Sample) -> bytes:
        native = sample.native
        if self._feed.native and native is not None and not hasattr(native, "encoding"):
            return native.data
        if self._known:
            return encode_cdr(self._type, self._message(sample))
        raise UnsupportedOperation(f"messages of {self._type} have no serialised form")

    def _message(self, sample: Sample) -> Any:
        value = to_plain(sample.value)
        feed = self._feed
        if feed.mapping is not None:
            beside = None if self._newest is None else self._newest.value
            return feed.mapping.message(Source(value, time_of(sample.timestamp), beside))
        return {"data": value} if feed.wraps else value


def _unsigned(number: int) -> bytes:
    return b"\x1b" + struct.pack(">Q", number)
