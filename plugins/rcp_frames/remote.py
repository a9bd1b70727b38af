"""Resources of robots with a gateway of their own: it converts, and only it knows the transforms."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from rcp_frames.feeds import RemoteFeed
from rcp_frames.goal_schema import Schema, resolved
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import InvalidValue, RcpError
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Backend, Encoded, FrameWatch
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ValueType
from rcp_streams.path_subscription import Subscriber

__all__ = ["RemoteStreams", "RemoteView", "names_frame"]

_AWAY = "its gateway cannot be reached"
_MOVED = frozenset(
    ("pose", "transform", "position", "translation", "twist", "accel", "linear", "point", "vector")
)
_BY_ID: dict[str, bool] = {}


def names_frame(type_: ValueType) -> bool:
    """Return whether values of a type name their frame, as far as its schema tells.

    The robot's own gateway has the last word.
    """
    known = _BY_ID.get(type_.schema_id)
    if known is None:
        known = _BY_ID[type_.schema_id] = _names_frame(type_.schema)
    return known


def _names_frame(schema: Schema) -> bool:
    defs: Schema = schema.get("$defs", {})
    fields: Schema = resolved(schema, defs).get("properties", {})
    header: Schema = resolved(fields.get("header"), defs).get("properties", {})
    named = "frame_id" in fields or "frame_id" in header
    turned = "orientation" in fields and "linear_acceleration" not in fields
    return named and (turned or not _MOVED.isdisjoint(fields))


class RemoteView:
    """A resource's values in a frame, as its robot's own gateway converts them for a session."""

    remote = True

    def __init__(
        self,
        streams: RemoteStreams,
        session: Session,
        entry: Entry,
        frame: str,
        locates: Callable[..., bool],
    ) -> None:
        """`locates` tells whether the session may know now where a robot is; `ever`: at times."""
        self._streams, self._session, self._locates = streams, session, locates
        self._frame, self._entry, self.value_type = frame, entry, entry.value_type

    def check(self) -> None:
        """Make sure that the session may know where the robot is; its gateway decides the rest.

        :raises InvalidValue: it may not, and for it the robot has no transforms.
        """
        if not self._locates(self._entry):
            raise self._unknown()

    def convert(self, sample: Sample) -> Sample:
        """Return the sample, which came converted; raises as `check`, at each one."""
        self.check()
        return sample

    def feed(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> RemoteFeed:
        """Create the feed of a subscription."""
        return RemoteFeed(subscription, entry, outbox, self)

    def _unknown(self) -> InvalidValue:
        return InvalidValue(
            f"there is no transform to the frame '{self._frame}'",
            remedy="Omit `frame`.",
            details={"pointer": "/frame", "frames": []},
        )

    def follow(
        self,
        entry: Entry,
        rate: float | None,
        offer: Callable[[Sample], None],
        missing: Callable[[str], None],
    ) -> Callable[[], None]:
        """Share the stream of the session's principal; return the end function."""
        unknown = self._unknown().message
        if not self._locates(entry, ever=True):  # asked again when the rights change
            missing(unknown)
            return _nothing
        backend = entry.owner.backend
        if backend is None:  # asked again when it opens
            missing(_AWAY)
            return _nothing
        key = _Key(backend, entry.name, self._frame, rate, self._session.principal)

        def offer_if(sample: Sample) -> None:
            if self._locates(entry):
                offer(sample)
            else:
                missing(unknown)

        def missing_if(why: str) -> None:
            missing(why if self._locates(entry) else unknown)

        return self._streams.join(key, entry, offer_if, missing_if)


class _Key(NamedTuple):
    """What streams share: all who want the same as the same person."""

    backend: Backend
    name: str
    frame: str
    rate: float | None
    principal: Principal


class RemoteStreams:
    """The streams of converted values from robots' own gateways."""

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        self._streams: dict[_Key, _Stream] = {}

    def join(
        self,
        key: _Key,
        entry: Entry,
        offer: Callable[[Sample], None],
        missing: Callable[[str], None],
    ) -> Callable[[], None]:
        """Receive the values of a stream, the current one first; return the end function."""
        stream = self._streams.get(key)
        if stream is None:
            try:
                stream = self._streams[key] = _Stream(key, entry, self._now)
            except RcpError as error:
                missing(error.message)
                return _nothing
        user = _User(offer, missing)
        stream.users[user] = None
        if stream.latest is not None:
            offer(stream.latest)
        elif stream.why is not None:
            missing(stream.why)
        return partial(self._leave, key, stream, user)

    def _leave(self, key: _Key, stream: _Stream, user: _User) -> None:
        stream.users.pop(user, None)
        if not stream.users and self._streams.get(key) is stream:
            del self._streams[key]
            stream.end()

    def close(self) -> None:
        """End all streams."""
        streams, self._streams = self._streams, {}
        for stream in streams.values():
            stream.end()


class _User:
    """One subscription to a stream."""

    __slots__ = ("missing", "offer")

    def __init__(self, offer: Callable[[Sample], None], missing: Callable[[str], None]) -> None:
        self.offer, self.missing = offer, missing


class _Stream:
    """A resource's values in one frame for one principal, each encoded once for all users."""

    def __init__(self, key: _Key, entry: Entry, now: Callable[[], int]) -> None:
        self._entry, self._now = entry, now
        self.users: dict[_User, None] = {}
        self.latest: Sample | None = None
        self.why: str | None = None
        watch = FrameWatch(key.frame, key.rate, key.principal, self._publish, self._miss)
        self.end = key.backend.watch_in_frame(key.name, watch)

    def _publish(self, value: Encoded) -> None:
        whole: Any = value
        sample = Sample(self._entry, whole, value.timestamp, self._now(), value.seq, "encoded")
        self.latest, self.why = sample, None
        for user in tuple(self.users):
            user.offer(sample)

    def _miss(self, why: str) -> None:
        self.why, self.latest = why, None
        for user in tuple(self.users):
            user.missing(why)


def _nothing() -> None:
    """End nothing."""
