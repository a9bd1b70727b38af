"""Servers of a service and of an action whose calls are carried out elsewhere.

A call is carried out by a task on the event loop, and nothing of rclpy waits meanwhile: a goal is
executed when its result is known, and the response of a service is sent then. Coroutines keep an
executor of rclpy busy while they wait, and end the process in the events executor; threads that
wait are all taken by the one client that does not respond.

The servers have a node and a thread of their own, with an executor that waits. The events executor
ends the process when a server of an action is destroyed just as something arrives for it: it then
releases Python objects without Python's lock.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

import msgspec
import structlog

from rcp_kernel.errors import DeviceTimeout, RcpError
from rcp_offers import Offered
from rcp_protocol.timeouts import timeout
from rcp_ros2.cdr import Codec
from rcp_ros2.filler import filler
from rcp_ros2.idl import fields_of
from rcp_ros2.link import RosLink
from rcp_ros2.ros import Ticket, contained

__all__ = ["ActionServer", "OfferNode", "ServiceServer"]

log = structlog.get_logger("rcp.ros2")
_CANCELLED = "cancelled"
_PATIENCE = 10.0  # s for the response of a service
_LAST = 0.5  # s for the last responses to be sent
_END = 1.0  # s for the thread to end
_MAKE = 4.0  # s for the thread to create a server
Outcome = tuple[Any, str | None]
"""A result, and why there is none."""


def _reader(cls: Any) -> Callable[[Any], Any]:
    """Return a function that converts a message object to plain data."""
    from rclpy.serialization import serialize_message

    if not fields_of(cls):
        return lambda _message: {}
    decode = Codec(cls).decode
    return lambda message: msgspec.to_builtins(decode(serialize_message(message)))


def _maker(cls: Any) -> Callable[[Any], Any]:
    """Return a function that converts plain data to a message object."""
    if not fields_of(cls):
        return lambda _value: cls()
    fill, type_ = filler(cls), Codec(cls).type
    return lambda value: fill(msgspec.convert(value or {}, type_))


class _Server(Protocol):
    """What is served; both are called in the thread of its callbacks, or once that has ended."""

    def create(self, node: Any) -> None:
        """Create the server on a node."""
        ...

    def destroy(self, node: Any) -> None:
        """Destroy it."""
        ...


class OfferNode:
    """A node with a thread for the callbacks of servers, from the first server on.

    Nothing here has the ROS thread wait for it, by which stops are sent, but the end of the backend.
    """

    def __init__(self, link: RosLink) -> None:
        self._link = link
        self._node: Any = None
        self._executor: Any = None
        self._thread: threading.Thread
        self._servers: set[_Server] = set()
        self._left: deque[_Server] = deque()
        """Those to be destroyed."""

    async def add(self, server: _Server, prepare: Callable[[], None]) -> None:
        """Have a server created, after `prepare` in the ROS thread.

        It is created in the thread of its callbacks: none is called before it is complete.

        :raises DeviceTimeout: that thread does not come to it; `remove` it.
        """
        created = Ticket(self._link.host)
        await self._link.ros.call(self._begin, server, prepare, created)
        if not await created.wait(_MAKE):
            raise DeviceTimeout(
                f"the thread of the offers did not create a server within {_MAKE:g} s",
                remedy="Check the gateway's log and load, then offer it again.",
            )
        created.result()

    def _begin(self, server: _Server, prepare: Callable[[], None], created: Ticket) -> None:
        prepare()
        if self._node is None:
            self._open()
        node = self._node

        def run() -> None:
            try:
                created.give(server.create(node))
            except Exception as error:
                created.fail(error)

        self._servers.add(server)
        self._executor.create_task(run)

    def _open(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        node = self._link.ros.node
        self._node = rclpy.create_node(
            f"{node.get_name()}_offers",
            context=node.context,
            namespace=node.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=_spin, args=(self._executor,), daemon=True)
        self._thread.start()

    def run(self, function: Callable[..., Any], *args: Any) -> None:
        """Run a function in the thread of the callbacks soon; its errors are logged."""
        executor = self._executor
        if executor is not None:
            executor.create_task(contained(function, *args))

    def remove(self, server: _Server) -> None:
        """Have a server destroyed; in the ROS thread."""
        if server not in self._servers:
            return
        self._servers.discard(server)
        self._left.append(server)
        self.run(self._destroy, server)  # not while the thread uses it, nor before it created it

    def close(self) -> None:
        """End the thread, and destroy the servers and the node; in the ROS thread."""
        if self._node is None:
            return
        self._executor.shutdown(timeout_sec=_END)
        self._thread.join(_END)
        self._left.extend(self._servers)
        self._servers.clear()
        for server in tuple(self._left):  # also what the thread has not come to
            self._destroy(server)
        self._node.destroy_node()
        self._node = self._executor = None

    def _destroy(self, server: _Server) -> None:
        if server in self._left:
            self._left.remove(server)
            contained(server.destroy, self._node)()


def _spin(executor: Any) -> None:
    from rclpy.executors import ExternalShutdownException, ShutdownException

    try:
        executor.spin()
    except (ExternalShutdownException, ShutdownException):
        pass  # the backend is being closed
    except Exception:
        log.exception("offers_failed")


class _Later:
    """In place of a response that is sent when it is known."""

    def __init__(self, request: Any) -> None:
        self.request = request


class ServiceServer:
    """A server of a service. At most as many of its calls wait as its offer lets."""

    def __init__(
        self, link: RosLink, type_: Any, name: str, offered: Offered, node: OfferNode
    ) -> None:
        self._link = link
        self._type = type_
        self._name = name
        self._offered = offered
        self._node = node
        self._server: Any = None
        self._send: Callable[[Any, Any], None]
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Create the server."""
        await self._node.add(self, self._prepare)

    def _prepare(self) -> None:
        self._read, self._make = _reader(self._type.Request), _maker(self._type.Response)

    def create(self, node: Any) -> None:
        """Create it on a node; in the thread of its callbacks."""
        server = node.create_service(self._type, self._name, self._called)
        self._send = server.send_response
        server.send_response = self._answer
        self._server = server

    def _called(self, request: Any, _response: Any) -> Any:
        try:
            return _Later(self._read(request))
        except Exception:  # it would end the executor, and every other service with it
            log.exception("offered_call_failed", service=self._name)
            return self._type.Response()

    def _answer(self, response: Any, header: Any) -> None:
        """Send a response, or have it made: the executor calls it with what `_called` returns."""
        if isinstance(response, _Later):
            with suppress(RuntimeError):  # the event loop has ended
                self._link.host.call_soon(self._start, response.request, header)
        else:
            self._send(response, header)

    def _start(self, request: Any, header: Any) -> None:
        task = asyncio.get_running_loop().create_task(self._carry_out(request, header))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _carry_out(self, request: Any, header: Any) -> None:
        outcome: Outcome
        try:
            async with timeout(_PATIENCE):
                outcome = await self._offered.call(request, _no_report), None
        except RcpError as error:
            outcome = None, error.message
        except TimeoutError:
            outcome = None, f"the client did not respond within {_PATIENCE:g} s"
        self._link.ros.post(self._respond, outcome, header)

    def _respond(self, outcome: Outcome, header: Any) -> None:
        if self._server is None:
            return
        try:
            self._send(self._response(*outcome), header)
        except Exception:  # it would end the thread of the whole backend
            log.exception("offered_call_failed", service=self._name)

    def _response(self, value: Any, error: str | None) -> Any:
        if error is None:
            try:
                return self._make(value)
            except (msgspec.ValidationError, ValueError, TypeError) as wrong:
                error = f"the client's response is not one of {self._name}: {wrong}"
        log.warning("offered_call_failed", service=self._name, reason=error)
        response = self._type.Response()
        for name, told in (("success", False), ("message", error)):
            with suppress(AssertionError, TypeError):  # of this type they are something else
                if hasattr(response, name):
                    setattr(response, name, told)
        return response

    def close(self) -> None:
        """Destroy the server, when the responses that are ready have been sent."""
        asyncio.get_running_loop().call_later(_LAST, self._link.ros.post, self._node.remove, self)

    def destroy(self, node: Any) -> None:
        """Destroy it, if it was created."""
        server, self._server = self._server, None
        if server is not None:
            node.destroy_service(server)


class ActionServer:
    """A server of an action."""

    def __init__(
        self, link: RosLink, type_: Any, name: str, offered: Offered, node: OfferNode
    ) -> None:
        self._link = link
        self._type = type_
        self._name = name
        self._offered = offered
        self._node = node
        self._server: Any = None
        self._goals: dict[bytes, asyncio.Task[None]] = {}

    async def open(self) -> None:
        """Create the server."""
        await self._node.add(self, self._prepare)

    def _prepare(self) -> None:
        self._read, self._make = _reader(self._type.Goal), _maker(self._type.Result)
        self._feed = _maker(self._type.Feedback)

    def create(self, node: Any) -> None:
        """Create it on a node; in the thread of its callbacks."""
        from rclpy.action.server import ActionServer as RosActionServer
        from rclpy.action.server import CancelResponse

        def cancel(goal: Any) -> Any:
            with suppress(RuntimeError):  # the event loop has ended
                self._link.host.call_soon(self._cancel, bytes(goal.goal_id.uuid))
            return CancelResponse.ACCEPT

        self._server = RosActionServer(
            node,
            self._type,
            self._name,
            execute_callback=lambda _goal: self._type.Result(),
            handle_accepted_callback=self._accepted,
            cancel_callback=cancel,
        )

    def _accepted(self, goal: Any) -> None:
        try:
            request = self._read(goal.request)
        except Exception as error:  # it would end the executor, and every other server with it
            self._execute(goal, (None, f"the goal cannot be read: {error}"))
            return
        with suppress(RuntimeError):  # the event loop has ended
            self._link.host.call_soon(self._start, goal, request)

    def _start(self, goal: Any, request: Any) -> None:
        id_ = bytes(goal.goal_id.uuid)
        task = asyncio.get_running_loop().create_task(self._carry_out(goal, request))
        self._goals[id_] = task
        task.add_done_callback(lambda _: self._goals.pop(id_, None))

    def _cancel(self, id_: bytes) -> None:
        task = self._goals.get(id_)
        if task is not None:
            task.cancel()

    async def _carry_out(self, goal: Any, request: Any) -> None:
        def report(feedback: Any = None, *, fraction: float | None = None) -> None:
            del fraction  # for which ROS has no place
            if feedback is not None:
                self._node.run(self._publish, goal, feedback)

        outcome: Outcome
        try:
            outcome = await self._offered.call(request, report), None
        except asyncio.CancelledError:
            outcome = None, _CANCELLED
        except RcpError as error:
            outcome = (error.details or {}).get("output"), error.message
        self._node.run(self._execute, goal, outcome)

    def _publish(self, goal: Any, feedback: Any) -> None:
        if goal.is_active:
            goal.publish_feedback(self._feed(feedback))

    def _execute(self, goal: Any, outcome: Outcome) -> None:
        if self._server is not None:
            goal.execute(lambda one: self._end(one, outcome))

    def _end(self, goal: Any, outcome: Outcome) -> Any:
        """Set the state of a goal; return its result."""
        value, error = outcome
        try:
            result = self._type.Result() if value is None else self._make(value)
        except (msgspec.ValidationError, ValueError, TypeError) as wrong:
            result = self._type.Result()
            error = f"the client's result is not one of {self._name}: {wrong}"
        if error is None:
            goal.succeed()
        elif error == _CANCELLED and goal.is_cancel_requested:
            goal.canceled()
        else:
            log.warning("offered_goal_failed", action=self._name, reason=error)
            goal.abort()
        return result

    def close(self) -> None:
        """Destroy the server, when the results that are ready have been sent."""
        asyncio.get_running_loop().call_later(_LAST, self._link.ros.post, self._node.remove, self)

    def destroy(self, node: Any) -> None:
        """Destroy it, if it was created."""
        del node
        server, self._server = self._server, None
        if server is not None:
            server.destroy()


def _no_report(feedback: Any = None, *, fraction: float | None = None) -> None:
    """Report nothing: services of ROS have no feedback."""
