"""What was recorded, by time: pages at `/system/history`, tables and copies for downloads."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import aclosing
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import iso, parse_time
from rcp_kernel.contract.caller import request_context
from rcp_kernel.errors import BadRequest, Forbidden, InvalidValue, RcpError, UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import Encoding
from rcp_recorder.pages import Page
from rcp_recorder.queries import Queries
from rcp_recorder.service import RecorderService
from rcp_recorder.writer import Writer
from rcp_recordings.query import STREAMED, Format, Query
from rcp_web.downloads import Download, HistoryPage

__all__ = ["HISTORY", "History", "HistoryRequest"]

HISTORY = "/system/history"
_READ = int(Operation.READ)
_NS = 1_000_000_000
_SPAN = re.compile(r"(\d+(?:\.\d+)?)(ms|s|m|h|d)?\Z")
_UNITS = {"ms": 0.001, None: 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_CURSOR = re.compile(r"(\d{1,19})\.(\d{1,9})\Z")
_ROOM = 8 * 2**20
"""Bytes of samples before the first moment, where nothing of the page is decoded here: pictures are long."""
_MEDIA = {
    "csv": "text/csv",
    "arrow": "application/vnd.apache.arrow.stream",
    "parquet": "application/vnd.apache.parquet",
    "mcap": "application/octet-stream",
    "ros2": "application/octet-stream",
}
Moment = Annotated[str, Meta(min_length=1, max_length=40)] | float


class HistoryRequest(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """What to return of the recordings of one resource."""

    path: (
        Annotated[str, Meta(max_length=512)]
        | Annotated[
            tuple[Annotated[str, Meta(max_length=512)], ...], Meta(min_length=1, max_length=64)
        ]
    )
    """The resource, which need not exist any more. Of a list, those that one may read; samples have their `path`."""
    start: Moment = msgspec.field(name="from", default=0.0)
    """The first moment: ISO 8601, seconds since the epoch, or before now (`-10m`); default: the oldest."""
    to: Moment | None = None
    """The end, which is not a part of it; default: now."""
    before: Annotated[int, Meta(ge=0, le=200)] = 0
    """Begin the first page with so many samples of each resource before `from`, however old they are."""
    every: Annotated[str, Meta(max_length=20)] | Annotated[float, Meta(gt=0)] | None = None
    """Length of the intervals of which minimum, maximum and mean are wanted: seconds, or `10s`, `1m`."""
    thin: bool = False
    """The first sample of each interval instead."""
    fields: Annotated[tuple[Annotated[str, Meta(min_length=1)], ...], Meta(max_length=64)] = ()
    """Only these fields of the value."""
    limit: Annotated[int, Meta(ge=1, le=10_000)] = 1000
    """Items in one page."""
    cursor: Annotated[str, Meta(max_length=40)] | None = None
    """From the previous page."""


class History:
    """Answers from recordings, for whoever may read the path in any state of the robots."""

    def __init__(
        self, host: FeatureHost, writer: Writer, service: RecorderService, queries: Queries
    ) -> None:
        self._host = host
        self._writer = writer
        self._service = service
        self._queries = queries

    async def execute(
        self, session: Session, wanted: HistoryRequest, *, dry_run: bool
    ) -> dict[str, Any] | Page:
        """Return one page."""
        query, path = self._query(session, wanted, "json")
        facts = {"path": path, **_span_of(query)}
        if dry_run:
            return facts
        current = request_context.get()
        encoding = Encoding.JSON if current is None else current[1].encoding
        return Page(await self._answer(replace(query, facts=facts, encoding=encoding)), encoding)

    async def page(
        self, session: Session, wanted: Mapping[str, Any], encoding: Encoding
    ) -> HistoryPage:
        """Return one page, for an HTTP request."""
        query, path = self._query(session, _request(wanted), "json")
        assert isinstance(path, str)  # a list is for `execute` alone
        query = replace(query, facts=_span_of(query), encoding=encoding, apart=True)
        cursor, _, data = (await self._answer(query)).partition(b"\n")
        return HistoryPage(path, Page(data, encoding), cursor.decode() or None)

    async def _answer(self, query: Query) -> bytes:
        async with aclosing(self._queries.answer(query)) as pieces:
            return b"".join([piece async for piece in pieces])

    async def table(self, session: Session, wanted: Mapping[str, Any], format_: str) -> Download:
        """Return everything in another format."""
        if format_ == "json":
            query, _ = self._query(session, _request(wanted), format_)
            query = replace(query, room=_ROOM)

            def page(_start: int, _stop: int | None) -> AsyncIterator[bytes]:
                return self._queries.answer(query)

            return Download(name="history.json", media="application/json", pieces=page)
        if format_ not in STREAMED:
            raise InvalidValue(
                f"there is no format {format_!r:.40}",
                remedy=f"Use one of json, {', '.join(STREAMED)}.",
            )
        query, path = self._query(session, _request(wanted), format_)
        assert isinstance(path, str)  # a list is for JSON alone
        stem = path.strip("/").replace("/", ".").replace("*", "all")
        suffix = "mcap" if format_ == "ros2" else format_
        return self._download(query, f"{stem}.{suffix}")

    def copy(self, query: Query, name: str) -> Download:
        """Return a copy of files."""
        return self._download(query, name)

    def _download(self, query: Query, name: str) -> Download:
        def pieces(_start: int, _stop: int | None) -> AsyncIterator[bytes]:
            return self._queries.answer(query, copy=True)

        return Download(name=name, media=_MEDIA[query.format], pieces=pieces)

    def _query(
        self, session: Session, wanted: HistoryRequest, format_: Format
    ) -> tuple[Query, str | list[str]]:
        now = self._host.clock.now()
        start = _moment("from", wanted.start, now)
        end = now if wanted.to is None else _moment("to", wanted.to, now)
        if end < start:
            raise InvalidValue("`to` is before `from`", remedy="Exchange them.")
        skip = 0
        if wanted.cursor is not None:
            start, skip = _place(wanted.cursor)
        copies = format_ in ("mcap", "ros2")
        _check_samples(wanted, format_)
        if copies and (wanted.every is not None or wanted.fields):
            raise BadRequest(
                "a copy has all samples as they are",
                remedy="Omit `every` and `fields`, or choose csv.",
            )
        if isinstance(wanted.path, tuple):
            paths = seen = self._of_several(session, wanted.path)
            text = sorted(paths)
        else:
            pattern = _pattern(wanted.path, session, literal=not copies)
            paths, seen = self._readable(session.rights, pattern)
            text = pattern.text
        files, whole = self._files(session, paths, start, end)
        before = wanted.before if wanted.cursor is None else 0
        return Query(
            files=files,
            earlier=self._earlier(paths, start) if before else (),
            before=before,
            named=isinstance(wanted.path, tuple),
            paths=paths,
            others=seen if whole and copies else frozenset(),
            start=start,
            end=end,
            every=None if wanted.every is None else _span(wanted.every),
            thin=wanted.thin,
            fields=wanted.fields,
            format=format_,
            limit=wanted.limit,
            skip=skip,
        ), text

    def _of_several(self, session: Session, wanted: tuple[str, ...]) -> frozenset[str]:
        """Return those that were recorded and may be read; of others nothing is told."""
        known = set(self._recorded())
        named = {_pattern(path, session, literal=True).text for path in wanted}
        return frozenset(
            path for path in named & known if self._service.mask(session.rights, path) & _READ
        )

    def _readable(self, rights: Rights, pattern: Pattern) -> tuple[frozenset[str], frozenset[str]]:
        """Return the recorded paths that match and may be read, and those that may be seen.

        :raises UnknownPath: there are none that may be seen.
        :raises Forbidden: those that may be seen may not be read.
        """
        known = set(self._recorded())
        if pattern.literal:
            known = (
                {pattern.text}
                if pattern.text in known | self._host.robots.entries.keys()
                else set()
            )
        masks = {path: self._service.mask(rights, path) for path in known if pattern.matches(path)}
        found = frozenset(path for path, mask in masks.items() if mask & _READ)
        if found:
            return found, frozenset(path for path, mask in masks.items() if mask)
        if any(masks.values()):
            raise Forbidden(
                f"you may not read {pattern.text}, or only in some states of the robot",
                path=pattern.text,
                remedy="Ask for a role that allows `read` without a condition.",
            )
        raise UnknownPath(f"no resource {pattern.text}", path=pattern.text)

    def _earlier(self, paths: frozenset[str], start: int) -> tuple[tuple[str, int | None], ...]:
        """List the newest file before a moment that has each path."""
        folder, missing, found = self._writer.catalogue.folder, set(paths), list[str]()
        ended = [kept for kept in self._writer.catalogue.files.values() if kept.end < start]
        for kept in sorted(ended, key=lambda kept: kept.end, reverse=True):
            if not missing.isdisjoint(kept.samples):
                found.append(str(folder / kept.file))
                missing -= kept.samples
        return tuple((name, None) for name in found)

    def _recorded(self) -> Iterable[str]:
        for kept in self._writer.catalogue.files.values():
            yield from kept.samples | kept.others
        for file in self._writer.open.values():
            if file.progress is not None:
                yield from file.progress.samples | file.progress.others

    def _files(
        self, session: Session, paths: frozenset[str], start: int, end: int
    ) -> tuple[tuple[tuple[str, int | None], ...], bool]:
        """List the files with something of it, and whether the session may see all that is in them."""
        folder, found, whole = self._writer.catalogue.folder, list[tuple[str, int | None]](), True
        for name, kept in self._writer.catalogue.files.items():
            if kept.start < end and kept.end >= start and not paths.isdisjoint(kept.samples):
                found.append((str(folder / name), None))
                whole = whole and self._service.sees(session.rights, (kept.samples, kept.others))
        for file in self._writer.open.values():
            written = file.progress
            if written is None or written.start >= end or paths.isdisjoint(written.samples):
                continue
            found.append((str(file.path), written.bytes))
            whole = whole and self._service.sees(session.rights, (written.samples, written.others))
        return tuple(sorted(found)), whole


def _span_of(query: Query) -> dict[str, str]:
    return {"from": iso(query.start), "to": iso(query.end)}


def _request(wanted: Mapping[str, Any]) -> HistoryRequest:
    try:
        return msgspec.convert(dict(wanted), HistoryRequest, strict=False)
    except msgspec.ValidationError as error:
        raise InvalidValue(str(error), remedy="See docs/recorder.md, History.") from None


def _pattern(path: str, session: Session, *, literal: bool) -> Pattern:
    pattern = Pattern(path, session.tenant)
    if literal and not pattern.literal:
        raise BadRequest(
            f"{path[:80]!r} is a pattern",
            remedy="Name one path; patterns are for the formats mcap and ros2.",
        )
    return pattern


def _check_samples(wanted: HistoryRequest, format_: Format) -> None:
    """Refuse a list of paths, and `before`, for anything but samples in JSON."""
    samples = format_ == "json" and (wanted.every is None or wanted.thin)
    if not samples and (wanted.before or isinstance(wanted.path, tuple)):
        raise BadRequest(
            "several paths, and `before`, are for samples in JSON",
            remedy="Name one path without `before`, or omit `format` and add `thin`.",
        )


def _moment(name: str, value: str | float, now: int) -> int:
    try:
        if isinstance(value, str) and value.startswith("-"):
            return max(0, now - _span(value[1:]))
        if isinstance(value, str) and _SPAN.match(value):
            value = float(value)
        return max(0, parse_time(value))
    except (RcpError, ValueError):
        raise InvalidValue(
            f"`{name}` is no time: {str(value)[:40]!r}",
            remedy="Use ISO 8601 in UTC, seconds since 1970, or a span before now such as -10m.",
        ) from None


def _span(value: str | float) -> int:
    match = _SPAN.match(str(value))
    span = 0 if match is None else int(float(match[1]) * _UNITS[match[2]] * _NS)
    if span <= 0:
        raise InvalidValue(
            f"{str(value)[:40]!r} is no span of time", remedy="Use seconds, or 500ms, 10s, 5m, 1h."
        )
    return span


def _place(cursor: str) -> tuple[int, int]:
    match = _CURSOR.match(cursor)
    if match is None:
        raise InvalidValue(
            "the cursor is not one of a page", remedy="Omit `cursor`, and begin again."
        )
    return int(match[1]), int(match[2])
