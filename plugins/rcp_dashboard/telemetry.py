"""Series and snapshots, in the form that pages draw."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.downsample import METHODS
from rcp_dashboard.request import DashboardRequest
from rcp_dashboard.watchers import Watchers, checked
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import iso, now, parse_time
from rcp_kernel.errors import BadRequest
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import Request, encode_reply

__all__ = ["Telemetry"]

_FIELDS = 16  # per request
_POINTS = 5000  # per series


class Telemetry:
    """Serves values."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig) -> None:
        self._client_api = client_api
        self._watchers = Watchers(client_api, config)
        self._samples = config.samples

    async def series(self, query: DashboardRequest) -> bytes:
        """Return fields of one resource over time, with at most the number of points to draw.

        :raises RcpError: the caller may not read it, or a field is not a number.
        """
        path = query.path()
        fields = query.several("field") or [""]
        if len(fields) > _FIELDS:
            raise BadRequest(f"a request can have at most {_FIELDS} fields")
        window = query.number("window", 0.001, 1e9)
        until = query.time("until")
        points = query.whole("points", 4, _POINTS, 600)
        choose = METHODS[query.word("method", tuple(METHODS))]
        watcher = self._watchers.of(query.principal, query.tenant, query.peer)
        found: list[dict[str, Any]] = []
        for field in fields:
            ring = await watcher.ring(path, field)
            if ring.skipped and not len(ring):
                raise BadRequest(
                    f"{field or 'the value'} of {path} is not a number",
                    path=path,
                    remedy="Use a field with a number: ?field=position.x.",
                )
            times, values = ring.window(window, until)
            chosen = choose(times, values, points)
            found.append(
                {
                    "field": field,
                    "samples": len(times),
                    "times": [times[place] for place in chosen],
                    "values": [values[place] for place in chosen],
                }
            )
        body = {"path": path, "capacity": self._samples, "now": now() / 1e9, "series": found}
        return msgspec.json.encode(body)

    async def latest(self, query: DashboardRequest) -> bytes:
        """Return the present value of every matching resource, without long ones.

        If they do not fit in one page, it is `truncated`, and `cursor` leads to the rest.

        :raises RcpError: the caller may not read them.
        """
        longest = query.whole("max_bytes", 1, 1 << 24, 4096)
        request = Request(type="read", path=query.path(pattern=True))
        if (cursor := query.text("cursor")) is not None:
            request.body = msgspec.Raw(msgspec.json.encode({"cursor": cursor}))
        reply = checked(await self._client_api.request(query.session, request))
        present = now()
        read = msgspec.json.decode(encode_reply(reply, Encoding.JSON))
        several = read["body"] if "*" in (request.path or "") else [read]
        values = [_described(one, present, longest) for one in several]
        found: dict[str, Any] = {"timestamp": iso(present), "values": values}
        if reply.truncated:
            found |= {"truncated": True, "cursor": reply.cursor}
        return msgspec.json.encode(found)

    def close(self) -> None:
        """Stop all recordings."""
        self._watchers.close()


def _described(one: dict[str, Any], present: int, longest: int) -> dict[str, Any]:
    kept = ("path", "status", "seq", "timestamp", "state", "error")
    found = {key: one[key] for key in kept if one.get(key) is not None}
    if one.get("error") is None:
        data = dump(one["body"], Encoding.JSON)
        if len(data) > longest:
            found["omitted"] = len(data)
        else:
            found["body"] = msgspec.Raw(data)
        stamp = one.get("source_timestamp") or one.get("timestamp")
        if stamp is not None:
            found["age"] = round((present - parse_time(stamp)) / 1e9, 3)
    return found
