"""What the recorder shows and takes at `/system/recorder`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["RecorderReply", "RecorderRequest", "RecordingState", "StartRequest"]

Name = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$")]


class StartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A recording to start."""

    name: Name
    """By which it is stopped, and its files begin."""
    paths: Annotated[tuple[str, ...], Meta(min_length=1, max_length=64)]
    """Paths and patterns. What matches now and may be read is recorded."""
    seconds: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    """When it ends by itself."""


class RecorderRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One thing to do."""

    start: StartRequest | None = None
    stop: Name | None = None
    """The name of a recording that a request started."""
    pin: str | None = None
    """A file that must not be deleted to make space."""
    unpin: str | None = None


class RecorderReply(msgspec.Struct, frozen=True, omit_defaults=True):
    """What was done."""

    done: Literal["started", "stopped", "pinned", "unpinned"]
    name: str
    """Of the recording, or of the file."""
    paths: int | None = None
    """How many are recorded."""


class RecordingState(msgspec.Struct, frozen=True, omit_defaults=True):
    """One file."""

    path: str
    """The name of the file in the recorder's folder."""
    name: str
    """The recording that it is a part of; `always` and `incident` are those of the configuration."""
    tenant: str
    state: Literal["recording", "kept"]
    start: str
    """Time of its first message."""
    bytes: int
    messages: int
    paths: tuple[str, ...] = ()
    """The resources of which it has something."""
    end: str | None = None
    """Time of its last message."""
    pinned: bool = False
    recovered: bool = False
    """Whether the gateway ended without closing it."""
    reason: str | None = None
    """Of an incident."""
    robot: str | None = None
    """Of an incident: the robot that it happened to."""
    at: str | None = None
    """Of an incident: when it happened."""
    link: str | None = None
    """Of an incident: the dashboard at that moment, after the dashboard's own address."""
