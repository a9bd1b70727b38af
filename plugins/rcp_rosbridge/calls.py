"""Calls of services, and goals of actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest, RcpError, UnknownPath
from rcp_kernel.wire import Reply, Request
from rcp_ros_messages import refused_response
from rcp_rosbridge.compatibility import decoded, has_bytes, modern
from rcp_rosbridge.context import Context, Packing
from rcp_rosbridge.graph import Graph, RosAction, RosService
from rcp_rosbridge.operations import CallService, CancelActionGoal, SendActionGoal
from rcp_rosbridge.replies import complaint, plain
from rcp_rosbridge.rosapi import Rosapi
from rcp_rosbridge.status import sentence

__all__ = ["Calls"]

_ROSAPI = "/rosapi/"
_NO_ARGUMENTS = msgspec.Raw(b"{}")
_LONGEST = 86_400.0  # s that a client can wait for a response
_GOALS = 256  # goals of one client that have not ended
_STATES = {"completed": 4, "cancelled": 5}
_ABORTED = 6
"""Of action_msgs/GoalStatus."""
Respond = Callable[[Any, bool], None]


class Calls:
    """Executes services and actions, and sends their results."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._rosapi = Rosapi(context)
        self._goals: dict[tuple[str, str], str | None] = {}
        """Command of each goal that has not ended, by action and id; None until it is accepted."""
        self._cancelled: set[tuple[str, str]] = set()

    # -- services ------------------------------------------------------------------------------

    def call(self, op: CallService) -> None:
        """Call a service; the response comes in any case."""
        respond = self._responder(op)

        def use(graph: Graph) -> None:
            try:
                self._call(op, graph, respond)
            except RcpError as error:
                respond(sentence(error), False)

        self._context.with_graph(use, lambda error: respond(sentence(error), False))

    def _responder(self, op: CallService) -> Respond:
        packing = Packing(
            int(op.fragment_size) if op.fragment_size else None, op.compression == "png"
        )
        done = False

        def respond(values: Any, result: bool) -> None:  # noqa: FBT001 - `result` of the response
            nonlocal done
            if done:
                return
            done = True
            response = {"op": "service_response", "service": op.service, "result": result}
            if op.id_ is not None:
                response["id"] = op.id_
            if not self._context.send({**response, "values": values}, packing):
                text = "the response is left out: too much that was sent before is unread"
                self._context.send({**response, "result": False, "values": text})

        return respond

    def _call(self, op: CallService, graph: Graph, respond: Respond) -> None:
        name = op.service if op.service.startswith("/") else f"/{op.service}"
        if name.startswith(_ROSAPI):
            self._rosapi.call(name.removeprefix(_ROSAPI), op.args, graph, respond)
            return
        service = graph.service(name)
        if service is None and name.startswith("/system/"):
            service = RosService(name, "", name, "", {}, {}, triggers=False)
        if service is None:
            raise UnknownPath(
                f"there is no service {op.service}",
                remedy="/rosapi/services lists those that you may call.",
            )
        request = Request(
            type="execute",
            path=service.path,
            body=arguments(op.args, service.input),
            deadline=_deadline(op.timeout),
        )

        def answer(reply: Reply) -> None:
            if reply.final:
                respond(*_response(service, reply))

        self._context.request(request, answer)

    # -- actions -------------------------------------------------------------------------------

    def send_goal(self, op: SendActionGoal) -> None:
        """Send a goal; its result comes in any case."""
        key = (op.action, str(op.id_))
        if key in self._goals:
            raise BadRequest(f"a goal '{key[1][:64]}' of {op.action} has not ended yet")
        if len(self._goals) >= _GOALS:
            raise BadRequest(f"a client has at most {_GOALS} goals at a time")
        self._goals[key] = None

        def failed(error: RcpError) -> None:
            self._end(op, sentence(error), _ABORTED, succeeded=False)

        def use(graph: Graph) -> None:
            action = graph.action(op.action)
            if action is None:
                failed(
                    UnknownPath(
                        f"there is no action {op.action}",
                        remedy="/rosapi/action_servers lists those that you may use.",
                    )
                )
                return
            if key in self._cancelled:
                self._end(op, {}, _STATES["cancelled"], succeeded=True)
                return
            self._execute(op, action)

        self._context.with_graph(use, failed)

    def _execute(self, op: SendActionGoal, action: RosAction) -> None:
        body = arguments(op.args, action.schemas.get("input"))
        mapping, key = action.mapping, (op.action, str(op.id_))
        if mapping is not None:
            body = msgspec.Raw(msgspec.json.encode(mapping.to_goal(decoded(body))))

        def answer(reply: Reply) -> None:
            if reply.command is not None and self._goals.get(key, "") is None:
                self._goals[key] = reply.command
                if key in self._cancelled:
                    self._cancel(op.action, str(op.id_), reply.command)
            if reply.final:
                self._finished(op, action, reply)
            elif reply.status == "in_progress" and op.feedback:
                self._feedback(op, action, reply)

        self._context.request(Request(type="execute", path=action.path, body=body), answer)

    def _feedback(self, op: SendActionGoal, action: RosAction, reply: Reply) -> None:
        if self._context.connection.outbox.crowded:  # the client does not read
            return
        values = plain(reply)
        if values is None and reply.progress is None:  # it has begun
            return
        values = values or {}
        if action.mapping is not None:
            values = action.mapping.to_feedback(values)
        feedback = {"op": "action_feedback", "action": op.action, "id": op.id_, "values": values}
        self._context.send(feedback)

    def _finished(self, op: SendActionGoal, action: RosAction, reply: Reply) -> None:
        if reply.error is not None and reply.status != "cancelled":
            self._end(op, complaint(reply), _ABORTED, succeeded=False)
            return
        values = plain(reply)
        if action.mapping is not None:
            values = action.mapping.to_result(values or {})
        state = _STATES.get(reply.status, _ABORTED)
        self._end(op, {} if values is None else values, state, succeeded=True)

    def _end(self, op: SendActionGoal, values: Any, state: int, *, succeeded: bool) -> None:
        key = (op.action, str(op.id_))
        self._goals.pop(key, None)
        self._cancelled.discard(key)
        result = {
            "op": "action_result",
            "action": op.action,
            "id": op.id_,
            "values": values,
            "status": state,
            "result": succeeded,
        }
        packing = Packing(
            int(op.fragment_size) if op.fragment_size else None, op.compression == "png"
        )
        if not self._context.send(result, packing):
            text = "the result is left out: too much that was sent before is unread"
            self._context.send({**result, "values": text, "result": False})

    def cancel_goal(self, op: CancelActionGoal) -> None:
        """Cancel a goal that the client has sent.

        :raises BadRequest: there is none.
        """
        key = (op.action, str(op.id_))
        if key not in self._goals:
            raise BadRequest(f"{op.action} has no goal '{key[1][:64]}' of this client")
        command = self._goals[key]
        if command is None:
            self._cancelled.add(key)
        else:
            self._cancel(op.action, key[1], command)

    def _cancel(self, action: str, id_: str, command: str) -> None:
        def answer(reply: Reply) -> None:
            if reply.error is not None:
                text = f"cannot cancel the goal of {action}: {reply.error['message']}"
                self._context.status.error(text, id_)

        self._context.request(Request(type="cancel", command=command), answer)


def arguments(args: msgspec.Raw, schema: dict[str, Any] | None) -> msgspec.Raw:
    """Return the input for the arguments of a call: an object, or a list in the order of the fields.

    :raises BadRequest: a list that is too long, or of what has no fields.
    """
    known = schema or {}
    body = modern(args or _NO_ARGUMENTS, known, has_bytes=has_bytes(known))
    if bytes(body).lstrip()[:1] != b"[":
        return body
    values = decoded(body)
    properties = list((schema or {}).get("properties") or {})
    if isinstance(ref := (schema or {}).get("$ref"), str):
        definitions = (schema or {}).get("$defs", {})
        properties = list(definitions.get(ref.rpartition("/")[2], {}).get("properties", {}))
    if len(values) > len(properties):
        raise BadRequest(f"{len(values)} arguments, but there are {len(properties)} fields")
    return msgspec.Raw(msgspec.json.encode(dict(zip(properties, values, strict=False))))


def _deadline(timeout: float | None) -> float | None:
    return min(timeout, _LONGEST) if timeout is not None and timeout > 0 else None


def _response(service: RosService, reply: Reply) -> tuple[Any, bool]:
    if reply.error is not None:
        answered = refused_response(reply.error)
        if answered is not None:
            return answered, True
        return complaint(reply), False
    values = plain(reply)
    if service.triggers:
        found: dict[str, Any] = {"success": True, "message": reply.message or ""}
        return found | values if isinstance(values, dict) else found, True
    if values is None:
        return {}, True
    return values if isinstance(values, dict) else {"data": values}, True
