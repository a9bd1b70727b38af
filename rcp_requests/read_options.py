"""What a `read` asks for, and the sample and reply that follow from it."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.clock import iso, now
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample, project
from rcp_kernel.values import value_type
from rcp_kernel.wire import Body, Reply, Request
from rcp_requests.pages import LONGEST, MOST

__all__ = ["READ_OPTIONS", "ReadOptions", "sample_at_hand", "sample_reply", "view_reply"]


class ReadOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The body of `read`; all fields are optional."""

    fields: tuple[str, ...] | None = None
    """Projection: only these fields of the value."""
    fresh: bool = False
    """Read from the robot even if a sample is available."""
    q: Annotated[str, Meta(max_length=200)] | None = None
    """Words that must all occur in an item of a list, such as `/system/robots`."""
    limit: Annotated[int, Meta(ge=1, le=MOST)] = MOST
    """Items per page of a pattern read, or of a searchable list."""
    cursor: Annotated[str, Meta(max_length=LONGEST)] | None = None
    """The cursor of the previous page."""
    frame: Annotated[str, Meta(min_length=1, max_length=64)] | None = None
    """The frame of the value; default: the robot's own."""


READ_OPTIONS = value_type(ReadOptions | None)


def sample_at_hand(entry: Entry, options: ReadOptions) -> Sample | None:
    """Return the latest sample if it answers a read; None if the robot has to be asked."""
    if options.fresh or entry.latest is None or entry.unit.usable_backend is None:
        return None
    if options.frame is not None and entry.owner.has_gateways:  # that gateway converts
        return None
    if entry.live or entry.listeners:
        return entry.latest
    # An actuator's value is the last one commanded, which the gateway itself has.
    return entry.latest if entry.kind == "actuator" else None


def sample_reply(request: Request, entry: Entry, sample: Sample, options: ReadOptions) -> Reply:
    """Return the reply with a sample."""
    body: Any = sample
    if options.fields:
        body = project(sample.value, options.fields)
    return Reply(
        type=request.type,
        id=request.id,
        path=entry.path,
        body=body,
        seq=sample.seq,
        source_timestamp=sample.time,
        state="stale" if entry.stale else "fresh",
        timestamp=iso(now()),
        custom=request.custom,
    )


def view_reply(request: Request, entry: Entry, value: Any, options: ReadOptions) -> Reply:
    """Return the reply with a value that was made for its reader just now."""
    truncated = isinstance(value, Body) and value.truncated
    if options.fields:
        value = project(value.value if isinstance(value, Body) else value, options.fields)
    moment = iso(now())
    return Reply(
        type=request.type,
        id=request.id,
        path=entry.path,
        body=value,
        truncated=truncated,
        source_timestamp=moment,
        state="fresh",
        timestamp=moment,
        custom=request.custom,
    )
