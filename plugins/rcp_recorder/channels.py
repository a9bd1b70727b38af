"""Channels and messages, as they pass from the event loop to the writer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from rcp_kernel.tree.samples import Source

__all__ = [
    "KIND",
    "PATH",
    "SAMPLE",
    "Channel",
    "Message",
    "Stream",
    "note_channel",
    "sample_channel",
]

PATH, KIND, SAMPLE = "path", "kind", "sample"
"""Metadata of a channel: the resource that it is about, and how."""
_OBJECT = b'{"type":"object"}'


class Channel(msgspec.Struct, frozen=True, eq=False):
    """What messages have in common; one object for each."""

    topic: str
    kind: str
    """`sample`, `command`, `event` or `estop`."""
    path: str | None = None
    """The resource that it is about; None: the tenant as a whole."""
    schema_name: str = "rcp.Event"
    schema: bytes = _OBJECT


class Message(NamedTuple):
    """One message of a file."""

    channel: Channel
    log_time: int
    """When the gateway received it, ns since the UNIX epoch."""
    publish_time: int
    """When its source says that it was, ns since the UNIX epoch."""
    seq: int
    data: bytes


class Stream:
    """A sequence of files that belong together: one recording in one tenant."""

    __slots__ = ("facts", "name", "robots", "tenant")

    def __init__(self, name: str, tenant: str, facts: Mapping[str, str]) -> None:
        self.name = name
        self.tenant = tenant
        self.facts = facts
        """Metadata of each of its files."""
        self.robots: Mapping[str, Mapping[str, str]] = {}
        """What is known of its robots, by path; replaced as a whole."""


def sample_channel(source: Source) -> Channel:
    """Return a channel for the samples of a resource, with the schema of its values."""
    kind = source.value_type
    return Channel(
        topic=source.path,
        kind=SAMPLE,
        path=source.path,
        schema_name=kind.schema_id.rpartition(".")[0],
        schema=msgspec.json.encode(kind.schema),
    )


def note_channel(kind: str, path: str | None, tenant: str) -> Channel:
    """Return a channel for commands or events of a resource, or of a tenant."""
    return Channel(
        topic=f"{path or f'/tenant/{tenant}'}/{kind}s",
        kind=kind,
        path=path,
        schema_name=f"rcp.{kind.title()}",
    )
