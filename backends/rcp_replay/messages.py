"""What a replay shows, and takes at `service/replay`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

__all__ = ["ReplayRequest", "ReplayState"]

Seconds = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
Ratio = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "1"})]
Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class ReplayRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What to change; all else stays as it is."""

    paused: bool | None = None
    """True stops the time of the recording, false lets it go on."""
    speed: Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "1"})] | None = None
    """How many times as fast as it was recorded."""
    seek: (
        Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
        | Annotated[str, Meta(max_length=40)]
        | None
    ) = None
    """Go to a moment: seconds after the beginning, or ISO 8601."""
    step: Annotated[int, Meta(ge=1, le=10_000, extra_json_schema={"unit": "1"})] | None = None
    """Publish so many messages, and pause."""
    loop: bool | None = None
    """Begin again at the end."""


class ReplayState(msgspec.Struct, frozen=True):
    """Where a replay is."""

    state: Literal["playing", "paused", "ended"]
    position: str
    """The moment of the recording."""
    elapsed: Seconds
    """The same, since the beginning."""
    start: str
    end: str
    duration: Seconds
    speed: Ratio
    loop: bool
    published: Count
    """Messages so far."""
    recordings: tuple[str, ...]
    """Names of the files."""
    jumps: Count = 0
    """How often its time was set: at the start, by a seek, and to begin again."""
