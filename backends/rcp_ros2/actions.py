"""Actions: goals, feedback, results, cancellation, and goals whose server fails."""

from __future__ import annotations

import asyncio
import time
import uuid
from typing import Any

import msgspec

from rcp_kernel.errors import AdapterUnavailable, Cancelled, DeviceRejected, DeviceTimeout
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.filler import filler
from rcp_ros2.idl import fields_of
from rcp_ros2.pulse import Pulse, node_of
from rcp_ros2.ros import Ticket, one_argument
from rcp_ros2.services import reader
from rcp_ros2.types import example_of, inward

__all__ = ["Goal", "Run"]

_FIRST_POLL = 0.3  # s until the first poll; a server that blocks its node does so by now
_POLL = 1.0  # s between two polls of a running goal's server
_REST = 4.0  # s for a cancelled goal to come to rest
_LATE = 2.0  # s that a cancel waits for its goal to be accepted
_MATCH = 2.0  # s for a client to find a server that the graph lists
_RACE = 0.1  # s to wait for the result of a goal that ended just before its cancel
_PAUSE = 0.02  # s between two polls of the result
_FEEDBACK = 0.05  # s between two checks of a running goal's feedback
_UNKNOWN, _SUCCEEDED, _CANCELED, _ABORTED = 0, 4, 5, 6  # action_msgs/msg/GoalStatus
_ACCEPTED, _REFUSED = 0, 1  # action_msgs/srv/CancelGoal


class Run(Binding):
    """An action resource."""

    def __init__(self, shared: Shared, name: str, mapping: Mapping, action: Any) -> None:
        self.action = action
        self.client: Any = None
        fields = fields_of(action.Goal)
        self._input = inward(action.Goal, mapping.unit, nan=mapping.nan) if fields else None
        self._fill = filler(action.Goal)
        self._goals: set[Goal] = set()
        self._node = ""
        self.nodes: frozenset[str] = frozenset()
        """The nodes that serve it."""
        result = Codec(action.Result, unit=mapping.unit)
        feedback = Codec(action.Feedback, unit=mapping.unit)
        self.read_result = reader(result) if fields_of(action.Result) else None
        self.read_feedback = reader(feedback) if fields_of(action.Feedback) else None
        type_name = f"{action.__module__.split('.')[0]}/action/{action.__name__}"
        resource = Resource(
            input=self._input,
            output=result.type if self.read_result else None,
            feedback=feedback.type if self.read_feedback else None,
            examples=example_of(self._input) if self._input else (),
            **common(
                name,
                mapping,
                f"Action {mapping.target} ({type_name}).",
                action=mapping.target,
                type=type_name,
            ),
        )
        super().__init__(shared, resource, mapping)

    @property
    def timeout(self) -> float:
        """Time-out in s for the server's response to a goal or cancel, not for the goal itself."""
        return self.shared.config.timeout

    @property
    def silence(self) -> float:
        """Maximum silence in s of a server that responded before."""
        return self.mapping.silence or self.shared.config.silence

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Send a goal and wait for its result.

        :raises AdapterUnavailable: there is no server, or it disappeared while it ran the goal.
        :raises DeviceRejected: the server refused the goal or aborted it.
        :raises DeviceTimeout: the server stopped responding.
        """
        return await self.follow(
            self.action.Goal() if value is None else self._fill(value), progress
        )

    async def follow(self, message: Any, progress: Progress) -> Any:
        """Send a goal message and wait for its result; raises as `execute`."""
        goal = Goal(self, message, progress)
        self._goals.add(goal)
        try:
            return await goal.run()
        finally:
            self._goals.discard(goal)

    async def reach(self) -> None:
        """Wait until a server accepts goals.

        :raises AdapterUnavailable: there is none.
        """
        await self.shared.present("action", self.mapping.target)
        if await self.shared.ros.call(self._is_silent):
            raise AdapterUnavailable(
                f"the node of action {self.mapping.target} no longer responds",
                remedy="Check the robot's node; it may have crashed or be blocked.",
            )
        end = time.monotonic() + _MATCH
        while not await self.shared.ros.call(self.is_ready):
            if time.monotonic() >= end:
                raise AdapterUnavailable(f"no server of {self.mapping.target} is available")
            await asyncio.sleep(_PAUSE)

    async def need_feedback(self) -> None:
        """Wait until the feedback of the motion arrives.

        :raises AdapterUnavailable: it is missing or too old.
        """
        if self.mapping.feedback is None:
            return

        def has_feedback() -> bool:
            return self.feedback is not None and self.feedback.is_fresh()

        if not await self.shared.until(has_feedback, self.shared.settling):
            why = self.feedback.missing() if self.feedback is not None else "no feedback yet"
            raise AdapterUnavailable(
                f"{why}: {self.mapping.target} accepts no goals without feedback",
                remedy="Check the node that publishes it.",
            )

    def is_ready(self) -> bool:
        """Return whether a server is available; called in the ROS thread."""
        if self.client is None:
            self.client = self.shared.action_clients.of(self.action, self.mapping.target)
        self.servers()
        return self.client.server_is_ready()

    def servers(self) -> frozenset[bytes]:
        """Return the publishers of the action's status: a new one means a restarted server."""
        topic = f"{self.mapping.target}/_action/status"
        endpoints = self.shared.ros.node.get_publishers_info_by_topic(topic)
        named = [name for name in map(node_of, endpoints) if name is not None]
        self.nodes = frozenset(named)
        if named:
            self._node = named[-1]
            self.shared.pulses.want(f"action {self.mapping.target}", named[-1:])
        return frozenset(bytes(endpoint.endpoint_gid) for endpoint in endpoints)

    def _is_silent(self) -> bool:
        return self.shared.pulses.is_silent(self._node)

    def pulse(self) -> Pulse | None:
        """Return the liveness monitor of the server's node."""
        return self.shared.pulses.of(self._node)

    async def halt(self) -> None:
        """Cancel every running goal; return when the server has confirmed it."""
        await asyncio.gather(*(goal.stop() for goal in list(self._goals)))

    def close(self) -> None:
        """Monitor its server no more."""
        self.shared.ros.post(self._drop)

    def _drop(self) -> None:
        if self.client is not None:
            self.shared.pulses.want(f"action {self.mapping.target}", ())
            self.client = None


def _is_refused(answer: Any) -> bool:
    """Return whether a server refused a cancel; rclpy then returns an empty list of goals."""
    nothing = answer.return_code == _ACCEPTED and not answer.goals_canceling
    return nothing or answer.return_code == _REFUSED


class Goal:
    """One goal, from request to result."""

    def __init__(self, run: Run, message: Any, progress: Progress) -> None:
        self._run = run
        self._ros = run.shared.ros
        self._name = run.mapping.target
        self._message = message
        self._progress = progress
        self._accepted = Ticket(run.shared.host)
        self._result = Ticket(run.shared.host)
        self._pulse: Pulse | None = None
        self._answers = 0
        """The node's response count when it was first polled for this goal."""
        self._servers: frozenset[bytes] = frozenset()
        self._last_message_at = time.monotonic()
        self._seen: Any = None
        """The goal handle; used only in the ROS thread."""
        self._sent = False
        self._result_requested = False
        self._abandoned = False
        self._stopping = False
        self._id = uuid.uuid4().bytes

    async def run(self) -> Any:
        """Run the goal to its end; a cancellation is sent to the server before this returns."""
        try:
            await self._run.reach()
            await self._run.need_feedback()
            if self._stopping:
                raise Cancelled(f"{self._name} was stopped before the goal was sent")
            self._sent = True
            await self._send()
            return await self._follow()
        except asyncio.CancelledError:
            stopping = asyncio.ensure_future(self._cancelled())
            stopping.add_done_callback(lambda task: task.cancelled() or task.exception())
            result = await asyncio.shield(stopping)
            if result is None:
                raise
            return result[0]
        except (AdapterUnavailable, DeviceTimeout):
            # If the server is alive after all, its goal must not continue unobserved.
            if self._run.shared.config.on_loss != "continue":
                self._abandon()
            raise

    # -- event loop ------------------------------------------------------------------------------

    async def _send(self) -> None:
        await self._ros.call(self._send_goal)
        if not await self._accepted.wait(self._run.timeout):
            raise self._run.late(f"the server of {self._name}")
        handle = self._accepted.result()
        if not handle.accepted:
            await self._check_others()
            raise DeviceRejected(
                f"the server of {self._name} rejected the goal",
                remedy="Send a goal that the robot can reach from its current position.",
            )
        self._progress()  # the robot may move from now on: what fails later was not refused
        await self._ros.call(self._request_result, handle)

    async def _check_others(self) -> None:
        """Cancel the goal at other servers of the action, if there are any.

        A server that was restarted is there twice for a while, which makes a failure of a rejection.

        :raises DeviceRejected: there are, and one of them may have begun with it.
        """
        servers = await self._ros.call(self._run.servers)
        if len(servers) <= 1:
            return
        self._ros.post(self._cancel_rejected)
        self._progress()
        nodes = sorted(self._run.nodes)
        named = " and ".join(nodes)
        if len(nodes) <= 1:  # the same node started twice, such as by its launch file
            named = f"{len(servers)} servers of {named or 'a node'}"
        raise DeviceRejected(
            f"a server of {self._name} rejected the goal, but {named} serve it: "
            "another one may have begun with it, and was told to cancel it",
            remedy="Have one node serve the action.",
        )

    async def _follow(self) -> Any:
        pause = _FIRST_POLL
        next_ = time.monotonic() + pause
        while not await self._result.wait(min(pause, _FEEDBACK) if self._run.feedback else pause):
            await self._need_feedback()
            if time.monotonic() >= next_:
                await self._poll()
                pause = _POLL
                next_ = time.monotonic() + pause
        status, value = self._result.result()
        return self._outcome(status, value)

    async def _need_feedback(self) -> None:
        """Cancel the goal if its feedback is lost.

        :raises DeviceTimeout: the feedback was lost.
        """
        feedback = self._run.feedback
        if feedback is None or feedback.is_fresh():
            return
        why = feedback.missing()
        await self.stop()
        raise DeviceTimeout(
            f"{why}: the goal of {self._name} was cancelled",
            remedy="Check the node that publishes the feedback.",
        )

    async def _poll(self) -> None:
        """Monitor the server, so that the goal does not wait for a dead one."""
        ready = await self._ros.call(self._inspect)
        if self._result.done:
            return
        if not ready:
            raise AdapterUnavailable(
                f"the server of {self._name} disappeared while it ran the goal"
            )
        pulse = self._pulse
        if pulse is None:
            return
        silent = time.monotonic() - max(self._last_message_at, pulse.last_response)
        # A server that blocks its node while it works cannot respond although it is alive:
        # only a server that has responded during this goal can be reported as lost.
        if pulse.answers > self._answers and silent > self._run.silence:
            raise DeviceTimeout(
                f"the server of {self._name} sent nothing for {silent:.1f} s while it ran the goal",
                remedy="Check the robot's node, and the robot's state before the next goal.",
            )

    def _outcome(self, status: int, value: Any) -> Any:
        if status == _SUCCEEDED:
            return value
        details = {"result": msgspec.to_builtins(value)} if value is not None else None
        if status == _ABORTED:
            words = ("error_msg", "error_message", "error_string", "message", "status_message")
            reason = next((w for w in (getattr(value, key, None) for key in words) if w), None)
            why = f": {reason}" if reason else ""
            raise DeviceRejected(f"{self._name} aborted the goal{why}", details=details)
        if status == _CANCELED:
            if self._stopping:
                raise Cancelled(f"{self._name} was stopped")
            raise DeviceRejected(
                f"{self._name} cancelled the goal itself, or for another client", details=details
            )
        raise AdapterUnavailable(
            f"the server of {self._name} was restarted and no longer knows the goal"
        )

    async def _cancelled(self) -> tuple[Any] | None:
        """Cancel the goal; return its result if it succeeded before the cancel."""
        if not await self.stop():
            return None
        status, value = self._result.result()
        return (value,) if status == _SUCCEEDED else None

    async def stop(self) -> bool:
        """Cancel the goal and wait until it has ended; return whether there was one to cancel.

        :raises DeviceRejected: the server refuses to cancel, or has rejected the goal while another
            one may have begun with it.
        :raises DeviceTimeout: the server has not confirmed the cancel.
        """
        self._stopping = True
        if not self._sent:
            return False
        if not await self._accepted.wait(_LATE):
            self._abandon()
            raise DeviceTimeout(
                f"the server of {self._name} has not responded to the goal yet",
                remedy="The goal will be cancelled as soon as it is accepted; check the robot's node.",
            )
        handle = self._accepted.result()
        if not handle.accepted:
            await self._check_others()
            return False
        answer = Ticket(self._run.shared.host)
        self._ros.post(self._request_cancel, handle, answer)  # however late the thread comes to it
        end = time.monotonic() + _REST
        await answer.wait(_REST)
        if answer.done and _is_refused(answer.result()) and not await self._result.wait(_RACE):
            raise DeviceRejected(
                f"the server of {self._name} refuses to cancel; the goal continues"
            )
        if not await self._result.wait(max(0.0, end - time.monotonic())):
            self._abandon()
            raise DeviceTimeout(
                f"the cancel of {self._name} was sent but is not confirmed",
                remedy="Check the robot: it may still be moving. Use the e-stop if in doubt.",
            )
        return True

    def _abandon(self) -> None:
        self._ros.post(self._cancel_unseen)

    # -- ROS thread ------------------------------------------------------------------------------

    def _send_goal(self) -> None:
        from unique_identifier_msgs.msg import UUID

        self._run.admit()
        id_ = self._id
        self._run.shared.sent(id_)
        future = self._run.client.send_goal_async(
            self._message,
            feedback_callback=one_argument(self._on_feedback),
            goal_uuid=UUID(uuid=list(id_)),
        )
        future.add_done_callback(one_argument(self._admitted))
        self._accepted.follow(future)
        self._servers = self._run.servers()

    def _admitted(self, future: Any) -> None:
        self._seen = future.result()
        if self._abandoned:
            self._cancel_unseen()

    def _cancel_rejected(self) -> None:
        """Cancel a goal that one server has rejected, wherever else it runs."""
        self._cancel_unseen(rejected=True)

    def _cancel_unseen(self, *, rejected: bool = False) -> None:
        """Cancel an abandoned goal, now or as soon as its server responds again."""
        self._abandoned = True
        server = self._run.shared.keeper.servers.get(self._name)
        if server is not None:
            server.abandon(self._id, rejected=rejected)
        handle = self._seen
        if handle is not None and handle.accepted and self._run.client is not None:
            handle.cancel_goal_async()

    def _request_result(self, handle: Any) -> None:
        self._result_requested = True
        read = self._run.read_result

        def convert(response: Any) -> tuple[int, Any]:
            return response.status, None if read is None else read(response.result)

        self._result.follow(handle.get_result_async(), convert)

    def _request_cancel(self, handle: Any, answer: Ticket) -> None:
        answer.follow(handle.cancel_goal_async())
        if not self._result_requested:  # cancelled between acceptance and the result request
            self._request_result(handle)

    def _on_feedback(self, message: Any) -> None:
        self._last_message_at = time.monotonic()
        if self._run.read_feedback is not None:
            self._ros.host.call_soon(self._progress, self._run.read_feedback(message.feedback))

    def _inspect(self) -> bool:
        servers = self._run.servers()
        if servers - self._servers:  # a new server does not know this goal
            self._servers |= servers
            self._request_result(self._seen)
        pulse = self._run.pulse()
        if pulse is not self._pulse and pulse is not None:
            self._pulse, self._answers = pulse, pulse.answers
            pulse.ping()
        return self._run.is_ready()
