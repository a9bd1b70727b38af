"""`read`: from the latest sample or the robot, with projections and patterns."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Generator, Iterator, Mapping
from functools import partial
from itertools import islice
from time import perf_counter
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.clock import iso, iso_bytes, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.internal_errors import attribute_error
from rcp_kernel.contract.metrics import SHORTEST, RequestCounts
from rcp_kernel.errors import (
    AdapterUnavailable,
    FilterUnsupported,
    RcpError,
    UnsupportedOperation,
)
from rcp_kernel.features.resource import Filter, Pages, View
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.account import passes
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.spi import Backend, Publication, has_watch
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Sample, masked, project
from rcp_kernel.values import value_type
from rcp_kernel.wire import Body, Reply, Request
from rcp_requests.admission import Resolver
from rcp_requests.inflight import InFlight
from rcp_requests.object_list import ObjectList, expected, is_listing, listed
from rcp_requests.pages import LONGEST, MOST, cursor_of, place_of, room
from rcp_requests.pattern_read import PatternRead
from rcp_requests.prompt_reply import PromptReply
from rcp_scheduling.turns import Turns, Work, at_once
from rcp_streams.frames import FrameConverter

__all__ = ["READ_OPTIONS", "ReadHandler", "ReadOptions"]

_READ = int(Operation.READ)
_to_json = msgspec.json.Encoder().encode
_STEP = 16  # samples checked per step
_HEAD = b'{"type":"read"'
_HEAD_WITH_ID = b'{"type":"read","id":'
_FRESH = b'fresh","timestamp":"'
_STALE = b'stale","timestamp":"'


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


class ReadHandler:
    """The handler of `read`, and of `status`."""

    def __init__(
        self,
        registry: Registry,
        resolver: Resolver,
        inflight: InFlight,
        counts: RequestCounts,
        turns: Turns,
        tree_views: TreeViews,
        *,
        views: Mapping[str, View],
        pages: Mapping[str, Pages],
        filters: Mapping[str, Filter],
        frames: FrameConverter,
        settings: Settings,
    ) -> None:
        self._registry = registry
        self._resolver = resolver
        self._inflight = inflight
        self._counts = counts
        self._seconds = counts.seconds
        self._outcomes = counts.outcomes
        self._turns = turns
        self._tree_views = tree_views
        self._views = views
        self._pages = pages
        self._filters = filters
        self._frames = frames
        self._settings = settings

    def read(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Answer an ordinary read; leave others to the slower handlers."""
        path = request.path
        known = session.rights.masks.get(path, 0) & _READ
        entry = self._registry.entries.get(path) if known else None  # pyright: ignore[reportArgumentType]
        if (
            entry is not None
            and entry.live
            and (sample := entry.latest) is not None
            and not request.body
            and entry.unit.usable_backend is not None
        ):
            if entry.value_type.grows and self._turns.over:
                self._read_later(session, request, entry, answer, ReadOptions())
                return None
            return Reply(
                type="read",
                id=request.id,
                path=entry.path,
                body=sample,
                seq=sample.seq,
                source_timestamp=sample.time,
                # The backend is open, so only age can make it stale.
                state="stale" if entry.deadline is not None and entry.stale else "fresh",
                timestamp=iso(now()),
                custom=request.custom,
            )
        return self._read_any(session, request, answer)

    def _read_later(
        self,
        session: Session,
        request: Request,
        entry: Entry,
        answer: Answer,
        options: ReadOptions,
    ) -> None:
        """Answer from a long latest sample when its turn has come.

        :raises QueueFull: too many requests of the client are waiting.
        """
        started = perf_counter()

        def work() -> Work:
            sample = entry.latest
            assert sample is not None
            reply = _reply(request, entry, sample, options)
            self._counts.conclude(session.transport, reply, started)
            answer(reply)
            yield

        self._turns.run(session.principal.identity, work())

    def read_prompt(self, session: Session, request: Request) -> PromptReply | None:
        """Return what `read_at_once` does, and of which sample."""
        reply = self.read_at_once(session, request)
        if reply is None:
            return None
        entry = self._registry.entries[request.path or ""]
        assert entry.latest is not None
        stale = entry.deadline is not None and entry.stale
        return PromptReply(reply, entry.latest.seq, stale)

    def read_at_once(self, session: Session, request: Request) -> bytes | None:
        """Return the JSON reply to an ordinary read; None for any other.

        It equals the reply of `read`, spliced around the encoded sample.
        """
        started = perf_counter()
        path = request.path
        if not session.rights.masks.get(path, 0) & _READ:
            return None
        entry = self._registry.entries.get(path)  # pyright: ignore[reportArgumentType]
        if (
            entry is None
            or not entry.live
            or (sample := entry.latest) is None
            or request.body
            or request.custom is not None
            or entry.unit.usable_backend is None
            or (entry.value_type.grows and self._turns.over)
        ):
            return None
        try:
            piece = sample.json_piece or sample.read_piece()
        except RcpError:
            return None
        if (account := session.account) is not None and not passes(account, session.monotonic()):
            return None
        state = _STALE if entry.deadline is not None and entry.stale else _FRESH
        head = _HEAD if request.id is None else _HEAD_WITH_ID + _to_json(request.id)
        reply = b"".join((head, piece, state, iso_bytes(now()), b'"}'))
        seconds = self._seconds
        spent = perf_counter() - started
        if spent <= SHORTEST:  # `observe` without a call
            seconds.counts[0] += 1
            seconds.total += spent
        else:
            seconds.observe(spent)
        key, outcomes = session.read_key, self._outcomes
        outcomes[key] = outcomes.get(key, 0) + 1
        return reply

    def status(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply | None]:
        """Answer with the health report."""
        request.path = "/system/status"
        return (yield from self.read_in_steps(session, request, answer))

    def _read_any(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Answer from the latest sample if possible, otherwise from the backend."""
        options = request.decode_body(READ_OPTIONS, "read") or ReadOptions()
        if request.path is not None and "*" in request.path:
            if options.q is not None:
                raise _unsearchable(request.path)
            return self._read_many(session, request, answer, options)
        entry = self._entry(session, request, options)
        if entry.path in self._views or entry.path in self._filters:
            return at_once(self._read_own(session, request, entry, options))
        if (sample := _at_hand(entry, options)) is not None:
            if entry.value_type.grows and self._turns.over and options.frame is None:
                self._read_later(session, request, entry, answer, options)
                return None
            return _reply(request, entry, self._in_frame(session, options, entry, sample), options)
        fetched = self._fetch_for(session, options.frame, entry)
        return self._fetch_later(session, request, answer, entry, fetched, options)

    def _fetch_later(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        entry: Entry,
        fetched: Coroutine[Any, Any, Sample],
        options: ReadOptions,
    ) -> None:
        """Answer when a value has been fetched."""
        self._inflight.answer_later(
            session,
            request,
            answer,
            fetched,
            lambda sample: _reply(
                request, entry, self._in_frame(session, options, entry, sample), options
            ),
            self._inflight.deadline(request, entry),
            entry.path,
        )

    def _entry(self, session: Session, request: Request, options: ReadOptions) -> Entry:
        entry = self._resolver.resolve(session, request.path, Operation.READ)
        pageable = entry.path in self._pages
        if options.q is not None and not pageable:
            raise _unsearchable(entry.path)
        if options.cursor is not None and not pageable:
            raise FilterUnsupported(
                "`cursor` needs a pattern, and this is a single path",
                path=entry.path,
                remedy="Send the pattern that the cursor belongs to.",
            )
        type_ = entry.value_type
        if options.frame is not None:
            type_ = self._frames.view(session, entry, options.frame).value_type
        for field in options.fields or ():
            if not type_.has_field(field):
                raise FilterUnsupported(f"{entry.path} has no field '{field}'", path=entry.path)
        return entry

    def _in_frame(
        self, session: Session, options: ReadOptions, entry: Entry, sample: Sample
    ) -> Sample:
        """Return a sample in the frame of the options.

        :raises RcpError: there is no transform to it.
        """
        if options.frame is None:
            return sample
        return self._frames.view(session, entry, options.frame).convert(sample)

    def read_in_steps(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply | None]:
        """Like `read`, in steps for values that depend on the reader."""
        path = request.path
        if path not in self._views and path not in self._filters:
            return self.read(session, request, answer)
        options = request.decode_body(READ_OPTIONS, "read") or ReadOptions()
        entry = self._entry(session, request, options)
        return (yield from self._read_own(session, request, entry, options))

    def _read_own(
        self, session: Session, request: Request, entry: Entry, options: ReadOptions
    ) -> Generator[None, None, Reply]:
        yield from self._tree_views.catch_up(session.rights)  # the visible part depends on it
        view = self._views.get(entry.path)
        if view is None:
            shown = partial(self._filters[entry.path], session)
            sample = yield from _last_shown(entry, shown)
            return _reply(request, entry, sample, options)
        if (pages := self._pages.get(entry.path)) is not None:
            return (yield from self._read_page(session, request, entry, options, pages))
        value = view(session)
        if is_listing(value):
            longest = room(self._settings.limits.message)
            value = yield from listed(value, expected(session, request), longest)
        return _viewed(request, entry, value, options)

    def _read_page(
        self,
        session: Session,
        request: Request,
        entry: Entry,
        options: ReadOptions,
        pages: Pages,
    ) -> Generator[None, None, Reply]:
        after = "" if options.cursor is None else place_of(options.cursor)
        items = pages(session, q=options.q or "", after=after)
        longest = room(self._settings.limits.message)
        page = yield from listed(items, expected(session, request), longest, options.limit)
        reply = _viewed(request, entry, page, options)
        if page.truncated:
            reply.cursor = cursor_of(page.last["path"])
        return reply

    def fetch(self, entry: Entry) -> Coroutine[Any, Any, Sample]:
        """Read a value from the backend; wait for the next sample if it can only publish.

        The next sample is the one after this call, not after the first step of the coroutine.
        """
        return self._fetch(entry, entry.latest)

    async def _fetch(self, entry: Entry, seen: Sample | None) -> Sample:
        backend = entry.unit.usable_backend
        if backend is None:
            raise entry.unit.unavailable()
        started = perf_counter()
        try:
            value = await _attributed(entry, backend.read(entry.name))
        except UnsupportedOperation:
            # A backend that has just opened may have declared the path anew.
            entry = self._registry.entries.get(entry.path, entry)
            if (sample := entry.latest) is not None and sample is not seen:
                return sample
            return await _first(entry, backend)
        entry.owner.latency = perf_counter() - started
        if isinstance(value, Publication):
            return entry.publish(value.value, value.timestamp)
        return entry.publish(value, None)

    def _fetch_for(
        self, session: Session, frame: str | None, entry: Entry
    ) -> Coroutine[Any, Any, Sample]:
        """Read a value that is not at hand, in a frame if its robot has a gateway that converts."""
        if frame is None or not entry.owner.has_gateways:
            return self.fetch(entry)
        return self._fetch_in_frame(session, entry, frame)

    async def _fetch_in_frame(self, session: Session, entry: Entry, frame: str) -> Sample:
        """Read a value in a frame from the robot's own gateway, which knows its transforms."""
        self._frames.view(session, entry, frame).check()  # there, the hub's own rights may count
        backend = entry.unit.usable_backend
        if backend is None:
            raise entry.unit.unavailable()
        value: Any = await _attributed(entry, backend.read_in_frame(entry.name, frame))
        return Sample(entry, value, value.timestamp, now(), value.seq, "encoded")

    def _read_many(
        self, session: Session, request: Request, answer: Answer, options: ReadOptions
    ) -> Reply | None:
        pattern = Pattern(request.path or "", session.tenant)
        after = "" if options.cursor is None else place_of(options.cursor)
        entries = list(islice(self._readable(session, pattern, options, after), options.limit + 1))
        more = len(entries) > options.limit
        del entries[options.limit :]
        page = PatternRead(
            entries,
            options.fields,
            at_hand=partial(_at_hand, options=options),
            fetch=partial(self._fetch_for, session, options.frame),
            shown=partial(self._in_frame, session, options),
            page=ObjectList(expected(session, request)),
            longest=room(self._settings.limits.message),
        )

        def done(items: ObjectList) -> Reply:
            truncated = more or len(items) < len(entries)
            return Reply(
                type="read",
                id=request.id,
                path=pattern.text,
                body=items,
                truncated=truncated,
                cursor=cursor_of(entries[len(items) - 1].path) if truncated else None,
                timestamp=iso(now()),
            )

        patience = (
            min(request.deadline or self._settings.limits.deadline, self._settings.limits.deadline)
            * 0.9
        )
        self._inflight.answer_later(
            session,
            request,
            answer,
            page.run(self._turns, session.principal.identity, patience),
            done,
            request.deadline or self._settings.limits.deadline,
            pattern.text,
        )
        return None

    def _readable(
        self, session: Session, pattern: Pattern, options: ReadOptions, after: str
    ) -> Iterator[Entry]:
        """List the matches of a pattern by path, without values that depend on the reader.

        With a frame, only those with values that name theirs.
        """
        plain = options.frame is None
        for entry in self._registry.match(pattern, after):
            if entry.path in self._views or entry.path in self._filters:
                continue
            if not plain and not self._frames.converts(entry):
                continue
            if entry.operations & Operation.READ and session.rights.permits(entry, Operation.READ):
                yield entry


def _unsearchable(path: str) -> FilterUnsupported:
    return FilterUnsupported(f"{path} cannot be searched", path=path, remedy="Omit `q`.")


def _at_hand(entry: Entry, options: ReadOptions) -> Sample | None:
    if options.fresh or entry.latest is None or entry.unit.usable_backend is None:
        return None
    if options.frame is not None and entry.owner.has_gateways:  # that gateway converts
        return None
    if entry.live or entry.listeners:
        return entry.latest
    # An actuator's value is the last one commanded, which the gateway itself has.
    return entry.latest if entry.kind == "actuator" else None


def _last_shown(entry: Entry, shown: Callable[[Any], Any]) -> Generator[None, None, Sample]:
    for number, sample in enumerate(reversed(tuple(entry.ring)), 1):
        if (visible := masked(sample, shown)) is not None:
            return visible
        if not number % _STEP:
            yield
    raise AdapterUnavailable(
        f"no event on {entry.path} yet",
        path=entry.path,
        remedy="Subscribe to it.",
    )


def _viewed(request: Request, entry: Entry, value: Any, options: ReadOptions) -> Reply:
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


def _reply(request: Request, entry: Entry, sample: Sample, options: ReadOptions) -> Reply:
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


async def _attributed(entry: Entry, reading: Awaitable[Any]) -> Any:
    """Read from a backend, and name it in its errors."""
    try:
        return await reading
    except RcpError as error:
        error.origin = error.origin or entry.owner.name
        raise
    except Exception as error:
        raise attribute_error(error, entry.owner.name, entry.path) from error


class _Waiter:
    def __init__(self) -> None:
        self.arrived: asyncio.Future[Sample] = asyncio.get_running_loop().create_future()

    def offer(self, sample: Sample) -> None:
        if not self.arrived.done():
            self.arrived.set_result(sample)


async def _first(entry: Entry, backend: Backend) -> Sample:
    """Watch until the first sample arrives; sources that publish unasked must have published."""
    if not has_watch(backend):
        raise AdapterUnavailable(
            f"{entry.path} has no value yet",
            path=entry.path,
            origin=entry.owner.name,
            remedy="Wait until the robot publishes it, or subscribe to it.",
        )
    waiter = _Waiter()
    entry.listeners.append(waiter)
    try:
        async with backend.watch(entry.name, None):
            return await waiter.arrived
    finally:
        if waiter in entry.listeners:
            entry.listeners.remove(waiter)
