"""`discover`: a page of the catalogue, made in steps."""

from __future__ import annotations

from collections.abc import Generator

from rcp_kernel.clock import iso, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.wire import Reply, Request
from rcp_requests.discovery import Discovery
from rcp_requests.discovery_page import DiscoveryPage
from rcp_requests.object_list import expected
from rcp_requests.pages import room

__all__ = ["DiscoverHandler"]


class DiscoverHandler:
    """The handler of `discover`."""

    def __init__(self, discovery: Discovery, settings: Settings) -> None:
        self._discovery = discovery
        self._settings = settings

    def discover(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply]:
        """Describe the resources of a pattern that a session may see."""
        page, longest = (
            DiscoveryPage(expected(session, request)),
            room(self._settings.limits.message),
        )
        yield from self._discovery.answer(session.rights, session.tenant, request, page, longest)
        return Reply(
            type="discover",
            id=request.id,
            path=request.path,
            body=page,
            truncated=page.cursor is not None,
            cursor=page.cursor,
            timestamp=iso(now()),
            custom=request.custom,
        )
