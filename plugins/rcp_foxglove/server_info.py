"""What a client is told first: who serves, what it can do, and the times of a recording."""

from __future__ import annotations

import secrets
from typing import Any

import msgspec

from rcp_foxglove.playback import Playback
from rcp_gateway.api import gateway_version

__all__ = ["ServerInfo"]

_NS = 1_000_000_000
_CAPABILITIES = (
    "clientPublish",
    "parameters",
    "parametersSubscribe",
    "services",
    "connectionGraph",
    "assets",
)


class ServerInfo:
    """The facts that are the same for all clients; `timed`: they are sent the gateway's time."""

    def __init__(self, title: str, *, timed: bool) -> None:
        self._title = title
        self._timed = timed
        self._session_id = secrets.token_hex(8)
        """Another one after each start: clients then forget what they know of the channels."""

    def encoded(self, playback: Playback) -> bytes:
        """Return the message for a client with its replay, if it sees one."""
        capabilities: list[str] = list(_CAPABILITIES)
        if self._timed or playback.active:
            capabilities.append("time")
        facts: dict[str, Any] = {
            "op": "serverInfo",
            "name": self._title,
            "capabilities": capabilities,
            "supportedEncodings": ["json", "cdr"],
            "metadata": {"server": f"rcp-gateway {gateway_version()}"},
            "sessionId": self._session_id,
        }
        if (times := playback.controlled) is not None:
            capabilities.append("playbackControl")
            facts["dataStartTime"], facts["dataEndTime"] = map(_stamp, times)
        return msgspec.json.encode(facts)


def _stamp(moment: int) -> dict[str, int]:
    return {"sec": moment // _NS, "nsec": moment % _NS}
