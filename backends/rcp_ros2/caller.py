"""A service client: created once, and calls that end if their server disappears."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout
from rcp_ros2.link import RosLink
from rcp_ros2.ros import Once, Ticket
from rcp_ros2.service_client import ServiceClient

__all__ = ["Caller"]

_POLL = 0.5  # s between two checks that the server still exists
_MATCH = 1.0  # s for a client to discover a server that the graph lists
_PAUSE = 0.02  # s between two checks of discovery
_UNMATCHED = object()


class Caller:
    """A client of one service."""

    def __init__(
        self,
        link: RosLink,
        srv: Any,
        name: str,
        *,
        presence: tuple[str, str] | None = None,
        convert: Callable[[Any], Any] | None = None,
        admit: Callable[[], None] | None = None,
    ) -> None:
        self._link = link
        self._srv = srv
        self._name = name
        self._presence = presence or ("service", name)
        """What must be in the graph: the service, or the kind of node that provides it."""
        self._convert = convert
        """Called with the response, in the ROS thread."""
        self._admit = admit
        """Called before a request is sent, in the ROS thread; raises to refuse it."""
        self._client: ServiceClient | None = None
        self._watch = _Watch(self._fault)

    async def call(
        self, request: Any, limit: float, admit: Callable[[], None] | None = None
    ) -> Any:
        """Call the service and return the response within `limit` seconds.

        `admit` checks this request as that of the constructor checks every one.

        :raises AdapterUnavailable: no node offers the service, or its node has disappeared.
        :raises DeviceTimeout: no response arrived in time.
        """
        if not self._link.graph.has(*self._presence):
            await self._link.present(*self._presence)
        until = time.monotonic() + min(limit, _MATCH)
        while (answer := await self._request(request, limit, admit)) is _UNMATCHED:
            if time.monotonic() >= until:
                raise AdapterUnavailable(f"no server of {self._name} is available")
            await asyncio.sleep(_PAUSE)
        return answer

    async def _request(self, request: Any, limit: float, admit: Callable[[], None] | None) -> Any:
        """Find the server and send the request in one visit to the ROS thread (0.1 ms)."""
        ticket, once = Ticket(self._link.host), Once()
        sent: list[Callable[[], None]] = []
        self._link.ros.submit(self._send, request, ticket, once, sent, admit or self._admit)
        self._watch.add(ticket, limit, once)
        try:
            return await ticket.answer()
        except BaseException:  # nobody waits for what may still come
            once.take()  # and what the thread has not come to is not sent any more
            self._link.ros.post(_forget, sent)
            raise
        finally:
            self._watch.remove(ticket)

    def _fault(self, once: Once, limit: float, left: float) -> Exception | None:
        """Return why a call with `left` of its `limit` seconds is not waited for any more."""
        if not self._link.graph.has(*self._presence):
            gone = AdapterUnavailable(f"the node that offers {self._name} has disappeared")
            return gone if once.take() else _unanswered(gone)
        if left <= 0:
            return DeviceTimeout(f"service {self._name} did not respond within {limit:g} s")
        return None

    def _send(
        self,
        request: Any,
        ticket: Ticket,
        once: Once,
        sent: list[Callable[[], None]],
        admit: Callable[[], None] | None,
    ) -> None:
        if not once.take():
            return
        try:
            client = self.prepare()
            if admit is not None:
                admit()
            if client.is_ready():
                sent.append(client.send(request, ticket, self._convert))
            else:
                ticket.give(_UNMATCHED)
        except Exception as error:
            ticket.fail(error)

    def prepare(self) -> ServiceClient:
        """Create the client early, so that it discovers the server; called in the ROS thread."""
        if self._client is None:
            self._client = ServiceClient(self._link.ros.node, self._srv, self._name)
        return self._client

    def close(self) -> None:
        """Destroy the client."""
        self._link.ros.post(self._drop)

    def _drop(self) -> None:
        if self._client is not None:
            self._client.destroy()
            self._client = None


def _forget(sent: list[Callable[[], None]]) -> None:
    """Give up a request that was sent; called in the ROS thread."""
    for give_up in sent:
        give_up()


def _unanswered(error: AdapterUnavailable) -> AdapterUnavailable:
    """Mark an error of a request that its node may have begun with, so that it is no refusal."""
    error.status, error.retryable = "failed", False
    error.remedy = "Check the robot, which may have acted, before you call it again."
    return error


class _Watch:
    """Ends the wait for answers, at their limits or because there is nobody to give them.

    One timer looks after all calls of a service: most are answered long before it rings.
    """

    def __init__(self, fault: Callable[[Once, float, float], Exception | None]) -> None:
        self._fault = fault
        self._waiting: dict[Ticket, tuple[Once, float, float]] = {}
        """For each answer who may send its request, its limit, and when that is over by the loop's clock."""
        self._alarm: asyncio.TimerHandle | None = None
        self._rings = float("-inf")

    def add(self, ticket: Ticket, limit: float, once: Once) -> None:
        """Look after an answer."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        self._waiting[ticket] = once, limit, now + limit
        self._ring_at(loop, now + min(limit, _POLL))

    def remove(self, ticket: Ticket) -> None:
        """Look after an answer no more."""
        del self._waiting[ticket]

    def _ring_at(self, loop: asyncio.AbstractEventLoop, moment: float) -> None:
        if self._alarm is None or moment < self._rings:
            if self._alarm is not None:
                self._alarm.cancel()
            self._alarm, self._rings = loop.call_at(moment, self._look, loop), moment

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        self._alarm = None
        now = loop.time()
        for ticket, (once, limit, end) in list(self._waiting.items()):
            try:
                error = self._fault(once, limit, end - now)
            except Exception as failed:  # of one call: the others have no other timer
                error = failed
            if error is None:
                self._ring_at(loop, min(end, now + _POLL))
            else:
                ticket.refuse(error)
