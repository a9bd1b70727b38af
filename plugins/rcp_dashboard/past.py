"""What robots told at a moment in the past, for the pages that look at it."""

from __future__ import annotations

from contextlib import aclosing
from typing import Any, cast

from rcp_dashboard.request import DashboardRequest
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, NotImplementedByRobot
from rcp_web.downloads import RECORDINGS

__all__ = ["Past"]

_OPTIONS = ("from", "to", "before", "cursor")


class Past:
    """Asks the recorder."""

    def __init__(self, client_api: ClientApi) -> None:
        self._client_api = client_api

    async def page(self, asked: DashboardRequest) -> bytes:
        """Return recorded samples of several resources, of those that the caller may read.

        :raises NotImplementedByRobot: nothing is recorded.
        :raises RcpError: an option is wrong, or too many are asking.
        """
        found = self._client_api.service(RECORDINGS)
        if found is None:
            raise NotImplementedByRobot(
                "this gateway records nothing",
                remedy="Ask its operator to configure [features.recorder].",
            )
        paths = asked.several("path")
        if not paths:
            raise BadRequest("`path` is missing", remedy="Add ?path=<path>, once for each.")
        wanted: dict[str, Any] = {"path": paths}
        for name in _OPTIONS:
            if (text := asked.text(name)) is not None:
                wanted[name] = text
        if (every := asked.text("every")) is not None:
            wanted |= {"every": every, "thin": True}
        page = await found.table(asked.session, wanted, "json")
        async with aclosing(cast("Any", page.pieces(0, None))) as pieces:
            return b"".join([piece async for piece in pieces])
