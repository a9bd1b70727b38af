"""How the samples of a resource are recorded: in a robot's own bytes, or in JSON that viewers draw."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_foxglove_types import Extension, extension, fields_of
from rcp_kernel.model import Kind, NativeType
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import Encoding
from rcp_recorder.channels import Channel, Message
from rcp_recordings.names import DESCRIPTION, NATIVE, QOS, SAMPLE, TOPIC, VALUE_SCHEMA

__all__ = ["SampleChannels"]

_JSON = Encoding.JSON
_LATCHED = ("/tf_static", "/robot_description", "/map")
"""Ends of the topics that late subscribers get by convention."""
_NEVER = "{sec: 9223372036, nsec: 854775807}"
_ORDINARY, _TRANSIENT = 2, 1
"""Durabilities, as rmw numbers them."""


class SampleChannels:
    """The channels of one resource."""

    def __init__(self, entry: Entry) -> None:
        schema = entry.value_type.schema
        text = msgspec.json.encode(schema)
        facts = {DESCRIPTION: entry.resource.description}
        name = entry.value_type.schema_id.rpartition(".")[0]
        self.entry = entry
        self._extension = extension(schema)
        self._json = _json_channel(entry.path, name, text, self._extension, facts)
        native = _native_type(entry)
        self._native: Channel | None = None
        self.whole = native is not None and _is_whole(native, schema)
        """Whether a ROS message is the value, so that nothing else has to be recorded of it."""
        if native is not None:
            more = facts | {VALUE_SCHEMA: text.decode()} if self.whole else facts
            self._native = _native_channel(entry, native, more, whole=self.whole)

    @property
    def topic(self) -> str | None:
        """The ROS topic that it is of."""
        return None if self._native is None else self._native.facts.get(TOPIC)

    def same(self, entry: Entry) -> bool:
        """Return whether a resource that was declared again has the same channels."""
        old, new = self.entry.resource, entry.resource
        return (
            self.entry.value_type.schema_id == entry.value_type.schema_id
            and old.native_types == new.native_types
            and old.meta == new.meta
        )

    def messages(self, sample: Sample, log_time: int, *, native: bool) -> list[Message]:
        """Return what is recorded of a sample; `native`: also the ROS message that it is a part of.

        :raises RcpError: it is not of its resource's type.
        """
        stamp, seq = sample.timestamp, sample.seq
        own = sample.native
        found: list[Message] = []
        if self._native is not None and own is not None:
            if self.whole or native:
                found.append(Message(self._native, log_time, stamp, seq, bytes(own.data)))
            if self.whole:
                return found
        data = sample.encoded(_JSON)  # shared with all subscribers in JSON
        if self._extension is not None and data != b"null":
            data = self._extension.encode(sample.value, data, stamp)
        found.append(Message(self._json, log_time, stamp, seq, data))
        return found


def _json_channel(
    path: str, name: str, schema: bytes, more: Extension | None, facts: dict[str, str]
) -> Channel:
    if more is not None:
        return Channel(
            path,
            SAMPLE,
            path,
            more.name,
            more.schema,
            facts=facts | {VALUE_SCHEMA: schema.decode()},
        )
    return Channel(path, SAMPLE, path, name, schema, facts=facts)


def _native_type(entry: Entry) -> NativeType | None:
    """Return the ROS message that a resource's samples come in."""
    native = entry.resource.native_types.get("value")
    if native is None or native.encoding != "cdr" or native.schema_encoding != "ros2msg":
        return None
    return native if entry.kind in (Kind.SENSOR, Kind.EVENT) else None


def _native_channel(
    entry: Entry, native: NativeType, facts: dict[str, str], *, whole: bool
) -> Channel:
    topic = entry.resource.meta.get("topic")
    if isinstance(topic, str):
        facts = facts | {TOPIC: topic, QOS: _qos(topic)}
    return Channel(
        topic=entry.path if whole else f"{entry.path}/{NATIVE}",
        kind=SAMPLE if whole else NATIVE,
        path=entry.path,
        schema_name=native.name,
        schema=native.schema.encode(),
        schema_encoding="ros2msg",
        encoding="cdr",
        facts=facts,
    )


def _is_whole(native: NativeType, schema: dict[str, Any]) -> bool:
    """Return whether values have exactly the fields of the message, and it can be decoded again."""
    if "wstring" in native.schema:  # which mcap-ros2-support does not decode
        return False
    own = native.schema.partition("\n====")[0]
    lines = (line.partition("#")[0].strip() for line in own.splitlines())
    fields = {
        line.split()[1]
        for line in lines
        if line and "=" not in line.split('"')[0].replace("<=", "")
    }
    return bool(fields) and fields == fields_of(schema)


def _qos(topic: str) -> str:
    """Return the QoS to publish a topic with, in YAML as rosbag2 writes it.

    Every subscriber matches it: reliable, and with the last message for late ones where that is usual.
    """
    durability = _TRANSIENT if topic.endswith(_LATCHED) else _ORDINARY
    return "\n".join(
        (
            "- history: 1",
            "  depth: 10",
            "  reliability: 1",
            f"  durability: {durability}",
            f"  deadline: {_NEVER}",
            f"  lifespan: {_NEVER}",
            "  liveliness: 1",
            f"  liveliness_lease_duration: {_NEVER}",
            "  avoid_ros_namespace_conventions: false",
        )
    )
