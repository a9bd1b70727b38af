"""Channels and messages, as they pass from the event loop to the writer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from rcp_recordings.names import MessageKind

__all__ = ["Channel", "Message", "Stream", "note_channel"]

_OBJECT = b'{"type":"object"}'


class Channel(msgspec.Struct, frozen=True, eq=False):
    """What messages have in common; one object for each."""

    topic: str
    kind: MessageKind
    path: str | None = None
    """The resource that it is about; None: the tenant as a whole."""
    schema_name: str = "rcp.Event"
    schema: bytes = _OBJECT
    schema_encoding: str = "jsonschema"
    encoding: str = "json"
    """Of the messages."""
    facts: Mapping[str, str] = {}
    """More metadata."""


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


def note_channel(kind: MessageKind, path: str | None, tenant: str) -> Channel:
    """Return a channel for commands or events of a resource, or of a tenant."""
    return Channel(
        topic=f"{path or f'/tenant/{tenant}'}/{kind}s",
        kind=kind,
        path=path,
        schema_name=f"rcp.{kind.title()}",
    )
