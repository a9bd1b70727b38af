"""A client of a service whose responses pass the executor without a task each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_ros2.ros import Ticket

__all__ = ["ServiceClient"]


class ServiceClient:
    """Sends requests, and gives the responses to their tickets; in the ROS thread.

    `call_async` of rclpy makes a future with two callbacks, and the executor a task for each of them, which
    is as much work as the rest of the thread's Python code for a call.
    """

    def __init__(self, node: Any, srv: Any, name: str) -> None:
        self._node = node
        self._client = node.create_client(srv, name)
        self._pending: dict[int, _Pending] = {}
        """By the sequence number of the request."""
        self._client.get_pending_request = self._pending.pop  # executors call it for each response

    @property
    def waiting(self) -> int:
        """Number of requests without a response."""
        return len(self._pending)

    def is_ready(self) -> bool:
        """Return whether a server was discovered."""
        return self._client.service_is_ready()

    def send(
        self, request: Any, ticket: Ticket, convert: Callable[[Any], Any] | None
    ) -> Callable[[], None]:
        """Send a request, whose response the ticket gets; return a function that gives it up."""
        with self._client.handle:
            number = self._client.handle.send_request(request)
        self._pending[number] = _Pending(ticket, convert)
        return lambda: self._forget(number)

    def _forget(self, number: int) -> None:
        self._pending.pop(number, None)

    def destroy(self) -> None:
        """Destroy it; what is pending gets no response."""
        self._node.destroy_client(self._client)


class _Pending:
    """What an executor of rclpy requires of the future of a response."""

    __slots__ = ("_convert", "_ticket")

    def __init__(self, ticket: Ticket, convert: Callable[[Any], Any] | None) -> None:
        self._ticket = ticket
        self._convert = convert

    def _set_executor(self, executor: object) -> None:
        """Do nothing: there are no callbacks to run as tasks of the executor."""

    def set_result(self, response: Any) -> None:
        """Give the response to the ticket, converted; an exception would end the executor."""
        convert = self._convert
        try:
            self._ticket.give(response if convert is None else convert(response))
        except Exception as error:
            self._ticket.fail(error)
