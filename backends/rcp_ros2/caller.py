"""A service client: created once, and calls that end if their server disappears."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout
from rcp_ros2.link import RosLink
from rcp_ros2.ros import Once, Ticket

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
        self._client: Any = None

    async def call(
        self, request: Any, limit: float, admit: Callable[[], None] | None = None
    ) -> Any:
        """Call the service and return the response within `limit` seconds.

        `admit` checks this request as that of the constructor checks every one.

        :raises AdapterUnavailable: no node offers the service, or its node has disappeared.
        :raises DeviceTimeout: no response arrived in time.
        """
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
        sent: list[Any] = []
        self._link.ros.submit(self._send, request, ticket, once, sent, admit or self._admit)
        watch = _Watch(ticket, limit, partial(self._fault, once))
        try:
            return await ticket.answer()
        except BaseException:  # nobody waits for what may still come
            once.take()  # and what the thread has not come to is not sent any more
            self._link.ros.post(self._forget, sent)
            raise
        finally:
            watch.close()

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
        sent: list[Any],
        admit: Callable[[], None] | None,
    ) -> None:
        if not once.take():
            return
        try:
            self.prepare()
            if admit is not None:
                admit()
            if not self._client.service_is_ready():
                ticket.give(_UNMATCHED)
                return
            future = self._client.call_async(request)
            sent.append(future)
            ticket.follow(future, self._convert)
        except Exception as error:
            ticket.fail(error)

    def prepare(self) -> None:
        """Create the client early, so that it discovers the server; called in the ROS thread."""
        if self._client is None:
            self._client = self._link.ros.node.create_client(self._srv, self._name)

    def _forget(self, sent: list[Any]) -> None:
        if self._client is not None and sent:
            self._client.remove_pending_request(sent[0])

    def close(self) -> None:
        """Destroy the client."""
        self._link.ros.post(self._drop)

    def _drop(self) -> None:
        if self._client is not None:
            self._link.ros.node.destroy_client(self._client)
            self._client = None


def _unanswered(error: AdapterUnavailable) -> AdapterUnavailable:
    """Mark an error of a request that its node may have begun with, so that it is no refusal."""
    error.status, error.retryable = "failed", False
    error.remedy = "Check the robot, which may have acted, before you call it again."
    return error


class _Watch:
    """Ends the wait for one answer, at its limit or because there is nobody to give it."""

    def __init__(
        self, ticket: Ticket, limit: float, fault: Callable[[float, float], Exception | None]
    ) -> None:
        self._ticket = ticket
        self._limit = limit
        self._fault = fault
        self._loop = asyncio.get_running_loop()
        self._end = self._loop.time() + limit
        self._alarm = self._loop.call_later(min(limit, _POLL), self._look)

    def _look(self) -> None:
        left = self._end - self._loop.time()
        error = self._fault(self._limit, left)
        if error is None:
            self._alarm = self._loop.call_later(min(left, _POLL), self._look)
        else:
            self._ticket.refuse(error)

    def close(self) -> None:
        """Look no more."""
        self._alarm.cancel()
