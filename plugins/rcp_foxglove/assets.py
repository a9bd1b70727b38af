"""Files of robots' descriptions, for viewers that draw them."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from rcp_foxglove.frames import asset, asset_failure
from rcp_foxglove.operations import FetchAsset
from rcp_foxglove.requests import UNREAD, Requests
from rcp_foxglove.statuses import refusal_text
from rcp_foxglove.views import View
from rcp_kernel.errors import NotImplementedByRobot, QueueFull
from rcp_kernel.wire import Request

__all__ = ["Assets"]

_AT_ONCE = 16


class Assets:
    """The files that one client reads."""

    def __init__(self, requests: Requests, put: Callable[[bytes], None]) -> None:
        self._requests = requests
        self._put = put
        self._running = 0

    def fetch(self, wish: FetchAsset, view: View) -> None:
        """Read a file from the first robot that has it."""
        if not view.assets:
            error = NotImplementedByRobot(
                "no robot here offers the files of its description",
                remedy="Use a ROS 2 robot with a robot_description, and a key that may execute "
                "`service/…/assets/fetch`.",
            )
            self._put(asset_failure(wish.request_id, refusal_text(error)))
        elif self._running >= _AT_ONCE:
            error = QueueFull(f"{self._running} files are being read for this client")
            self._put(asset_failure(wish.request_id, refusal_text(error)))
        else:
            self._running += 1
            self._requests.begin(self._fetch(wish, list(view.assets)))

    async def _fetch(self, wish: FetchAsset, services: list[str]) -> None:
        reasons: list[str] = []
        try:
            for path in services:
                body = msgspec.Raw(msgspec.json.encode({"uri": wish.uri}))
                reply = await self._requests.request(Request(type="execute", path=path, body=body))
                value = getattr(reply.body, "value", reply.body)
                data = (
                    value.get("data") if isinstance(value, dict) else getattr(value, "data", None)
                )
                if reply.error is None and isinstance(data, bytes):
                    if not self._requests.reply(asset(wish.request_id, data)):
                        self._put(
                            asset_failure(wish.request_id, f"It was dropped because {UNREAD}.")
                        )
                    return
                if (reason := refusal_text(reply)) not in reasons:
                    reasons.append(reason)
            self._put(asset_failure(wish.request_id, " ".join(reasons)))
        finally:
            self._running -= 1
