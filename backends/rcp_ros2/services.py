"""Services: one cached client each; calls end if their server disappears."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, DeviceTimeout
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.filler import filler
from rcp_ros2.idl import fields_of
from rcp_ros2.ros import Ticket
from rcp_ros2.types import example_of, inward

__all__ = ["Called", "Caller", "reader"]

_POLL = 0.5  # s between looks whether the server is still there
_MATCH = 1.0  # s for a client to find a server that the graph lists
_PAUSE = 0.02  # s between looks whether it has
_MARGIN = 1.0  # s that the gateway waits longer than the service has
_UNMATCHED = object()
_HARMLESS = {
    "composition_interfaces/srv/ListNodes",
    "lifecycle_msgs/srv/GetAvailableStates",
    "lifecycle_msgs/srv/GetAvailableTransitions",
    "lifecycle_msgs/srv/GetState",
    "map_msgs/srv/GetMapROI",
    "map_msgs/srv/GetPointMap",
    "nav_msgs/srv/GetMap",
    "nav_msgs/srv/GetPlan",
    "rcl_interfaces/srv/DescribeParameters",
    "rcl_interfaces/srv/GetLoggerLevels",
    "rcl_interfaces/srv/GetParameterTypes",
    "rcl_interfaces/srv/GetParameters",
    "rcl_interfaces/srv/ListParameters",
    "rcl_interfaces/srv/SetLoggerLevels",
    "sensor_msgs/srv/SetCameraInfo",
    "tf2_msgs/srv/FrameGraph",
    "type_description_interfaces/srv/GetTypeDescription",
}
"""Read-only service types; any other may move the robot."""


class Caller:
    """A client of one service."""

    def __init__(
        self,
        shared: Shared,
        srv: Any,
        name: str,
        *,
        presence: tuple[str, str] | None = None,
        convert: Callable[[Any], Any] | None = None,
        admit: Callable[[], None] | None = None,
    ) -> None:
        self._shared = shared
        self._srv = srv
        self._name = name
        self._presence = presence or ("service", name)
        """What must be in the graph: the service, or the kind of node that serves it."""
        self._convert = convert
        """Run on the response, in the ROS thread."""
        self._admit = admit
        """Run before a request is sent, in the ROS thread: raises if it must not be."""
        self._client: Any = None

    async def call(self, request: Any, limit: float) -> Any:
        """Call the service, and return the response within `limit` seconds.

        :raises AdapterUnavailable: no node offers the service, or the one that did has gone.
        :raises DeviceTimeout: no answer came in time.
        """
        await self._shared.present(*self._presence)
        until = time.monotonic() + min(limit, _MATCH)
        while (answer := await self._request(request, limit)) is _UNMATCHED:
            if time.monotonic() >= until:
                raise AdapterUnavailable(f"no server of {self._name} is available")
            await asyncio.sleep(_PAUSE)
        return answer

    async def _request(self, request: Any, limit: float) -> Any:
        """Find the server and send the request in one turn of the thread, which costs 0.1 ms."""
        ticket = Ticket(self._shared.host)
        sent: list[Any] = []
        self._shared.ros.submit(self._send, request, ticket, sent)
        try:
            return await self._answer(ticket, limit)
        finally:
            if not ticket.done:
                self._shared.ros.post(self._forget, sent)

    async def _answer(self, ticket: Ticket, limit: float) -> Any:
        end = time.monotonic() + limit
        while (left := end - time.monotonic()) > 0:
            if await ticket.wait(min(left, _POLL)):
                return ticket.result()
            if not self._shared.graph.has(*self._presence):
                raise AdapterUnavailable(f"the node that offers {self._name} has disappeared")
        raise DeviceTimeout(f"service {self._name} did not respond within {limit:g} s")

    def _send(self, request: Any, ticket: Ticket, sent: list[Any]) -> None:
        try:
            self.prepare()
            if self._admit is not None:
                self._admit()
            if not self._client.service_is_ready():
                ticket.give(_UNMATCHED)
                return
            future = self._client.call_async(request)
            sent.append(future)
            ticket.follow(future, self._convert)
        except Exception as error:
            ticket.fail(error)

    def prepare(self) -> None:
        """Have a client, so that the server is discovered; in the ROS thread."""
        if self._client is None:
            self._client = self._shared.ros.node.create_client(self._srv, self._name)

    def _forget(self, sent: list[Any]) -> None:
        if self._client is not None and sent:
            self._client.remove_pending_request(sent[0])

    def close(self) -> None:
        """Destroy the client."""
        self._shared.ros.post(self._drop)

    def _drop(self) -> None:
        if self._client is not None:
            self._shared.ros.node.destroy_client(self._client)
            self._client = None


def reader(codec: Codec) -> Callable[[Any], Any]:
    """Return the function that makes a typed value of a message object."""
    from rclpy.serialization import serialize_message

    return lambda message: codec.decode(serialize_message(message))


class Called(Binding):
    """A service of the tree."""

    def __init__(self, shared: Shared, name: str, mapping: Mapping, srv: Any) -> None:
        request, response = srv.Request, srv.Response
        self._input = inward(request, mapping.unit) if fields_of(request) else None
        self._fill = filler(request)
        self._request = request
        empty = not fields_of(response)
        convert = (lambda _response: None) if empty else reader(Codec(response, unit=mapping.unit))
        type_name = f"{srv.__module__.split('.')[0]}/srv/{srv.__name__}"
        moves = type_name not in _HARMLESS if mapping.moves is None else mapping.moves
        self._caller = Caller(shared, srv, mapping.target, convert=convert, admit=self.admit)
        facts = common(
            name,
            mapping,
            f"Service {mapping.target} ({type_name}).",
            service=mapping.target,
            type=type_name,
        )
        facts["timeout"] = (mapping.timeout or shared.config.timeout) + _MARGIN
        facts["moves"] = moves
        resource = Resource(
            input=self._input,
            output=None if empty else Codec(response, unit=mapping.unit).type,
            examples=example_of(self._input) if self._input else (),
            **facts,
        )
        super().__init__(shared, resource, mapping)

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Call the service.

        :raises DeviceRejected: its answer says `success: false`.
        """
        request = self._request() if value is None else self._fill(value)
        result = await self._caller.call(request, self.timeout)
        if getattr(result, "success", None) is False:
            raise _refusal(self.mapping.target, result)
        return result

    def close(self) -> None:
        """Destroy the client."""
        self._caller.close()


def _refusal(name: str, result: Any) -> DeviceRejected:
    words = ("message", "status_message", "error_message", "reason")
    reason = next((w for w in (getattr(result, key, None) for key in words) if w), None)
    return DeviceRejected(
        f"{name} refused: {reason}" if reason else f"{name} reported failure",
        details={"result": msgspec.to_builtins(result)},
    )
