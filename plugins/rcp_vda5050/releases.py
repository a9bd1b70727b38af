"""Requests to enter zones of the type RELEASE, and what the fleet manager answered.

VDA 5050 3.0 sections 6.4.3 and 6.9. A grant that is lost while the robot drives is told when the robot
stands, because the fleet manager may give the zone to another robot as soon as it reads that.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Collection
from datetime import UTC, datetime
from typing import Literal

from msgspec import Struct

from rcp_vda5050.zone_messages import Response

__all__ = ["Releases", "Request"]

_LATE = 0.01  # s after which a lease has surely expired


class Request(Struct):
    """One request, and how it stands."""

    id: str
    zone_set_id: str
    zone_id: str
    status: Literal["REQUESTED", "GRANTED", "REVOKED", "EXPIRED"] = "REQUESTED"
    expires: float | None = None
    """Unix time."""
    entered: bool = False
    granted: bool = False
    """Whether it ever was."""
    lost: Literal["REVOKED", "EXPIRED"] | None = None
    """Why a grant is of no use any more, until that is told."""
    retired: bool = False
    """Whether its zone set is no longer enabled."""

    @property
    def valid(self) -> bool:
        """Whether the robot may be in the zone now."""
        in_time = self.expires is None or time.time() < self.expires
        return self.status == "GRANTED" and self.lost is None and not self.retired and in_time


class Releases:
    """The requests of one robot; `lost` is called when a grant is, `news` with each other answer."""

    def __init__(self, lost: Callable[[Request], None], news: Callable[[], None]) -> None:
        self._lost, self._news = lost, news
        self._ids = itertools.count(1)
        self._began = f"{time.time():.0f}"
        self._requests: dict[str, Request] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self.rejected: set[str] = set()
        """Zones that the fleet manager refused since the last `want`."""

    def listed(self) -> list[dict[str, str]]:
        """Return `zoneRequests` of the state."""
        return [
            {
                "requestId": each.id,
                "requestType": "ACCESS",
                "zoneId": each.zone_id,
                "zoneSetId": each.zone_set_id,
                "requestStatus": each.status,
            }
            for each in self._requests.values()
        ]

    def of(self, zone_id: str) -> Request | None:
        """Return the request for a zone."""
        found = (each for each in self._requests.values() if each.zone_id == zone_id)
        return next((each for each in found if not each.retired), None)

    def want(self, zone_set_id: str, zone_ids: Collection[str]) -> None:
        """State requests for zones that have none."""
        for zone_id in zone_ids:
            if self.of(zone_id) is None and zone_id not in self.rejected:
                id_ = f"{self._began}-{next(self._ids)}"
                self._requests[id_] = Request(id_, zone_set_id, zone_id)
                self._news()

    def answer(self, response: Response) -> str | None:
        """Take an answer; return what is wrong with it. One to a request that is gone is no fault."""
        request = self._requests.get(response.request_id)
        if request is None or request.retired:
            return None
        match response.grant_type:
            case "GRANTED":
                return self._grant(request, response.lease_expiry)
            case "REVOKED":
                if request.status == "GRANTED" and request.lost is None:
                    self._lose(request, "REVOKED")
            case "REJECTED":
                if request.status == "GRANTED":
                    self._lose(request, "REVOKED")
                else:
                    self.rejected.add(request.zone_id)
                    self._drop(request)
                    self._news()
            case "QUEUED":
                # The schema of the state has no status for it: it stays requested.
                pass
        return None

    def _grant(self, request: Request, expiry: str | None) -> str | None:
        expires = None
        if expiry is not None:
            try:
                expires = _unix(expiry)
            except ValueError:
                return f"leaseExpiry {expiry!r} is no time of ISO 8601"
        self._stop_timer(request)
        request.expires = expires
        if expires is not None and expires <= time.time():
            if request.status == "GRANTED" and request.lost is None:
                self._lose(request, "EXPIRED")
            elif request.status != "GRANTED":
                request.status = "EXPIRED"
                self._news()
            return f"leaseExpiry {expiry} has passed already: are the clocks of robot and fleet manager set?"
        request.status, request.lost, request.granted = "GRANTED", None, True
        if expires is not None:
            self._start_timer(request)
        self._news()
        return None

    def _start_timer(self, request: Request) -> None:
        assert request.expires is not None
        left = max(0.0, request.expires - time.time()) + _LATE
        loop = asyncio.get_running_loop()
        self._timers[request.id] = loop.call_later(left, self._due, request)

    def _stop_timer(self, request: Request) -> None:
        if (timer := self._timers.pop(request.id, None)) is not None:
            timer.cancel()

    def _due(self, request: Request) -> None:
        if request.expires is not None and time.time() < request.expires:  # the clock was set back
            self._start_timer(request)
        elif request.status == "GRANTED" and request.lost is None:
            self._lose(request, "EXPIRED")

    def _lose(self, request: Request, why: Literal["REVOKED", "EXPIRED"]) -> None:
        self._stop_timer(request)
        request.lost = why
        self._lost(request)

    def settle(self) -> None:
        """Tell of lost grants: the robot does not drive. A zone that was not entered needs a new request."""
        for request in list(self._requests.values()):
            if request.retired or (request.lost is not None and not request.entered):
                self._drop(request)
            else:
                self.tell(request)

    def tell(self, request: Request) -> None:
        """Tell of one lost grant."""
        if request.lost is not None:
            request.status, request.lost = request.lost, None

    def keep(self, zone_ids: Collection[str]) -> None:
        """Drop the requests for all other zones, except those that wait to be settled."""
        for request in list(self._requests.values()):
            if request.zone_id not in zone_ids and not request.retired:
                self._drop(request)

    def retire(self) -> None:
        """Let all requests end with the present drive: their zones are no longer in force."""
        for request in self._requests.values():
            self._stop_timer(request)
            request.retired = True
        self.rejected.clear()

    def close(self) -> None:
        """Forget all."""
        for request in list(self._requests.values()):
            self._drop(request)

    def _drop(self, request: Request) -> None:
        self._stop_timer(request)
        self._requests.pop(request.id, None)


def _unix(text: str) -> float:
    """Return the Unix time of a text; without an offset it is UTC.

    :raises ValueError: it is no time.
    """
    found = datetime.fromisoformat(text)
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
