"""`read`: which of the ways answers it.

The latest sample here (`read_at_once` as spliced JSON, `read` otherwise), a call of the robot
(`ValueFetcher`), what is made for each reader (`ReaderViews`), or a page of many (`PatternRead`).
"""

from __future__ import annotations

from collections.abc import Coroutine, Generator, Iterator
from functools import partial
from itertools import islice
from time import perf_counter
from typing import Any

import msgspec

from rcp_kernel.clock import iso, iso_bytes, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.metrics import SHORTEST, RequestCounts
from rcp_kernel.errors import FilterUnsupported, RcpError
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.account import passes
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.wire import Reply, Request
from rcp_requests.admission import Resolver
from rcp_requests.inflight import InFlight
from rcp_requests.object_list import ObjectList, expected
from rcp_requests.pages import cursor_of, place_of, room
from rcp_requests.pattern_read import PatternRead
from rcp_requests.prompt_reply import PromptReply
from rcp_requests.read_options import READ_OPTIONS, ReadOptions, sample_at_hand, sample_reply
from rcp_requests.reader_views import ReaderViews
from rcp_requests.value_fetch import ValueFetcher
from rcp_scheduling.turns import Turns, Work, at_once
from rcp_streams.frames import FrameConverter

__all__ = ["ReadHandler"]

_READ = int(Operation.READ)
_to_json = msgspec.json.Encoder().encode
_HEAD = b'{"type":"read"'
_HEAD_WITH_ID = b'{"type":"read","id":'
_FRESH = b'fresh","timestamp":"'
_STALE = b'stale","timestamp":"'


class ReadHandler:
    """The handler of `read`, and of `status`."""

    def __init__(
        self,
        registry: Registry,
        resolver: Resolver,
        inflight: InFlight,
        counts: RequestCounts,
        turns: Turns,
        *,
        views: ReaderViews,
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
        self._views = views
        self._values = ValueFetcher(registry, frames)
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
            reply = sample_reply(request, entry, sample, options)
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
        if entry.path in self._views:
            return at_once(self._views.read(session, request, entry, options))
        if (sample := sample_at_hand(entry, options)) is not None:
            if entry.value_type.grows and self._turns.over and options.frame is None:
                self._read_later(session, request, entry, answer, options)
                return None
            return sample_reply(
                request, entry, self._in_frame(session, options, entry, sample), options
            )
        fetched = self._values.fetch(session, options.frame, entry)
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
            lambda sample: sample_reply(
                request, entry, self._in_frame(session, options, entry, sample), options
            ),
            self._inflight.deadline(request, entry),
            entry.path,
        )

    def _entry(self, session: Session, request: Request, options: ReadOptions) -> Entry:
        entry = self._resolver.resolve(session, request.path, Operation.READ)
        pageable = self._views.has_pages(entry.path)
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
        if path not in self._views:
            return self.read(session, request, answer)
        options = request.decode_body(READ_OPTIONS, "read") or ReadOptions()
        entry = self._entry(session, request, options)
        return (yield from self._views.read(session, request, entry, options))

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
            at_hand=partial(sample_at_hand, options=options),
            fetch=partial(self._values.fetch, session, options.frame),
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
            if entry.path in self._views:
                continue
            if not plain and not self._frames.converts(entry):
                continue
            if entry.operations & Operation.READ and session.rights.permits(entry, Operation.READ):
                yield entry


def _unsearchable(path: str) -> FilterUnsupported:
    return FilterUnsupported(f"{path} cannot be searched", path=path, remedy="Omit `q`.")
