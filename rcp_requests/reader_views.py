"""`read` of values that depend on the reader: what `/system/` shows to each session."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Any

from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.config.settings import Settings
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.features.resource import Filter, Pages, View
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample, masked
from rcp_kernel.wire import Reply, Request
from rcp_requests.object_list import expected, is_listing, listed
from rcp_requests.pages import cursor_of, place_of, room
from rcp_requests.read_options import ReadOptions, sample_reply, view_reply

__all__ = ["ReaderViews"]

_STEP = 16  # samples checked per step


class ReaderViews:
    """The values that each reader sees differently: made for it, or filtered from samples."""

    def __init__(
        self,
        views: Mapping[str, View],
        pages: Mapping[str, Pages],
        filters: Mapping[str, Filter],
        tree_views: TreeViews,
        settings: Settings,
    ) -> None:
        self._views = views
        self._pages = pages
        self._filters = filters
        self._tree_views = tree_views
        self._settings = settings

    def __contains__(self, path: str | None) -> bool:
        """Return whether the value of a path depends on the reader."""
        return path in self._views or path in self._filters

    def has_pages(self, path: str) -> bool:
        """Return whether a path is read by pages, and searched."""
        return path in self._pages

    def read(
        self, session: Session, request: Request, entry: Entry, options: ReadOptions
    ) -> Generator[None, None, Reply]:
        """Answer a read in steps."""
        yield from self._tree_views.catch_up(session.rights)  # the visible part depends on it
        view = self._views.get(entry.path)
        if view is None:
            shown = partial(self._filters[entry.path], session)
            sample = yield from _last_shown(entry, shown)
            return sample_reply(request, entry, sample, options)
        if (pages := self._pages.get(entry.path)) is not None:
            return (yield from self._read_page(session, request, entry, options, pages))
        value = view(session)
        if is_listing(value):
            longest = room(self._settings.limits.message)
            value = yield from listed(value, expected(session, request), longest)
        return view_reply(request, entry, value, options)

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
        reply = view_reply(request, entry, page, options)
        if page.truncated:
            reply.cursor = cursor_of(page.last["path"])
        return reply


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
