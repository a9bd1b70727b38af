"""`ping`: the shortest request, to check that the gateway responds."""

from __future__ import annotations

from time import perf_counter

import msgspec

from rcp_kernel.clock import iso, iso_bytes, now
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.sessions.account import passes
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.wire import Reply, Request

__all__ = ["PingHandler"]

_to_json = msgspec.json.Encoder().encode
_HEAD = b'{"type":"ping",'
_MIDDLE = b'"status":"completed","timestamp":"'


class PingHandler:
    """The handler of `ping`."""

    def __init__(self, counts: RequestCounts) -> None:
        self._seconds = counts.seconds
        self._outcomes = counts.outcomes

    def ping(self, _session: Session, request: Request, _answer: Answer) -> Reply:
        """Answer any ping."""
        return Reply(type="ping", id=request.id, timestamp=iso(now()), custom=request.custom)

    def ping_at_once(self, session: Session, request: Request) -> bytes | None:
        """Return the JSON reply to an ordinary ping, equal to that of `ping`; None for any other."""
        started = perf_counter()
        if request.custom is not None:
            return None
        if (account := session.account) is not None and not passes(account, session.monotonic()):
            return None
        head = _HEAD if request.id is None else b'{"type":"ping","id":%b,' % _to_json(request.id)
        reply = b"".join((head, _MIDDLE, iso_bytes(now()), b'"}'))
        self._seconds.observe(perf_counter() - started)
        key = (session.transport, "ping", "ok")
        self._outcomes[key] = self._outcomes.get(key, 0) + 1
        return reply
