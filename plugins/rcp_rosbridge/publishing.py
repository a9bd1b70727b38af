"""What a client publishes: writes to actuators, goals and parameters."""

from __future__ import annotations

from collections import deque
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.wire import Reply, Request
from rcp_ros_messages import message_type
from rcp_rosbridge.compatibility import decoded, modern
from rcp_rosbridge.context import Context
from rcp_rosbridge.graph import Graph, RosTopic, Target, same_type
from rcp_rosbridge.leases import Leases
from rcp_rosbridge.operations import Advertise, Publish, Unadvertise
from rcp_rosbridge.status import sentence

__all__ = ["Publishing"]

_MOST = 1000  # topics that a client publishes on
_IDS = 4096  # advertisements of one client, of all its topics
_QUEUE = 16  # messages of a topic that wait for the robot
_REMEDY = "Send a message of the topic's type; /rosapi/message_details describes it."
_BYTES = 4 * 1024 * 1024  # of all that wait


class _Outlet:
    """What waits for a topic's target: one message is on its way, the others wait."""

    __slots__ = ("busy", "waiting")

    def __init__(self) -> None:
        self.busy = False
        self.waiting: deque[tuple[Publish, float]] = deque()
        """Each with the time of its receipt, by the loop's clock."""


class Publishing:
    """Passes messages on to what they command, one after the other for each topic."""

    def __init__(self, context: Context, leases: Leases) -> None:
        self._context = context
        self._leases = leases
        self._advertised: dict[str, set[str | None]] = {}
        self._count = 0
        """Number of advertisements of all topics."""
        self._outlets: dict[str, _Outlet] = {}
        self._size = 0

    def advertise(self, op: Advertise) -> None:
        """Note that the client will publish, and tell it if that will have no effect.

        :raises BadRequest: there are too many.
        """
        ids = self._advertised.get(op.topic)
        if ids is None and len(self._advertised) >= _MOST:
            raise BadRequest(f"a client advertises at most {_MOST} topics")
        id_ = None if op.id_ is None else str(op.id_)
        if ids is None or id_ not in ids:
            if self._count >= _IDS:
                raise BadRequest(f"a client has at most {_IDS} advertisements")
            self._count += 1
            self._advertised.setdefault(op.topic, set()).add(id_)

        def use(graph: Graph) -> None:
            topic = graph.topic(op.topic)
            if topic is None or topic.target is None:
                self._context.status.warning(_nobody(op.topic, topic), id_)
            elif op.type and not same_type(op.type, topic.type):
                text = f"{op.topic} has the type {topic.type}, not {op.type}"
                self._context.status.error(text, id_)

        self._context.with_graph(use, lambda error: self._failed(op.topic, id_, error))

    def unadvertise(self, op: Unadvertise) -> None:
        """Note that it no longer will."""
        ids = self._advertised.get(op.topic)
        id_ = None if op.id_ is None else str(op.id_)
        if ids is None or (id_ is not None and id_ not in ids):
            self._context.status.warning(f"{op.topic} was not advertised", id_)
            return
        left = set[str | None]() if id_ is None else ids - {id_}
        self._count -= len(ids) - len(left)
        if left:
            self._advertised[op.topic] = left
        else:
            del self._advertised[op.topic]
            self._context.with_graph(lambda graph: self._release(op.topic, graph), lambda _: None)

    def _release(self, name: str, graph: Graph) -> None:
        topic = graph.topic(name)
        if topic is not None and topic.target is not None and name not in self._advertised:
            self._leases.release(topic.target.path)

    def publish(self, op: Publish) -> None:
        """Send a message, or keep it until the one before has been received."""
        outlet = self._outlets.get(op.topic)
        if outlet is None:
            if len(self._outlets) >= _MOST:
                raise BadRequest(f"a client publishes on at most {_MOST} topics")
            outlet = self._outlets[op.topic] = _Outlet()
        received = self._now()
        if not outlet.busy:
            self._send(op, outlet, received)
        elif self._size + len(op.msg) > _BYTES:
            self._skipped(op.topic)
        else:
            self._size += len(op.msg)
            outlet.waiting.append((op, received))
            if len(outlet.waiting) > _QUEUE:
                self._size -= len(outlet.waiting.popleft()[0].msg)
                self._skipped(op.topic)

    def close(self) -> None:
        """Drop what waits: the client has gone, and its robot is brought to rest."""
        self._outlets.clear()

    def _skipped(self, topic: str) -> None:
        text = f"messages on {topic} come faster than the robot takes them; some were skipped"
        self._context.status.warning(text, None, f"skipped {topic}")

    def _now(self) -> float:
        return self._context.client_api.loop.time()

    def _send(self, op: Publish, outlet: _Outlet, received: float) -> None:
        outlet.busy = True
        id_ = None if op.id_ is None else str(op.id_)

        def use(graph: Graph) -> None:
            topic = graph.topic(op.topic)
            if topic is None or topic.target is None:
                text = _nobody(op.topic, topic)
                self._context.status.error(text, id_, f"nobody {op.topic}")
                self._next(outlet, None)
            else:
                self._pass_on(op, topic, topic.target, outlet, received)

        def failed(error: RcpError) -> None:
            self._failed(op.topic, id_, error)
            self._next(outlet, None)

        self._context.with_graph(use, failed)

    def _pass_on(
        self, op: Publish, topic: RosTopic, target: Target, outlet: _Outlet, received: float
    ) -> None:
        id_ = None if op.id_ is None else str(op.id_)
        try:
            request = self._request(op, topic, target)
        except RcpError as error:
            self._failed(op.topic, id_, error)
            self._next(outlet, target)
            return
        window = request.valid_for

        def send(*, first: bool) -> None:
            if window is not None:  # a velocity that has waited must not act any longer
                request.valid_for = window - (self._now() - received)
                if request.valid_for <= 0:
                    self._skipped(op.topic)
                    self._next(outlet, target)
                    return
            self._context.request(request, lambda reply: answer(reply, first=first))

        def again(refusal: Reply | None) -> None:
            if refusal is None:
                send(first=False)
            else:
                answer(refusal, first=False)

        def answer(reply: Reply, *, first: bool) -> None:
            if reply.error is not None:
                if first and self._leases.may_help(target.path, reply.error["code"]):
                    self._leases.acquire(target.path, again)
                    return
                self._refused(op.topic, id_, reply.error)
            # A goal runs on when it is accepted; the next one may follow.
            if outlet.busy and (reply.final or target.kind == "action"):
                self._next(outlet, target)

        self._leases.keep(target.path)
        send(first=True)

    def _request(self, op: Publish, topic: RosTopic, target: Target) -> Request:
        body = modern(op.msg, topic.schema, has_bytes=topic.has_bytes)
        if target.mapping is not None or target.wraps:
            message = decoded(body)
            if target.wraps:
                if not isinstance(message, dict) or "data" not in message:
                    text = f"a message of {topic.type} has the field `data`"
                    raise BadRequest(text, remedy=_REMEDY)
                value: Any = message["data"]  # pyright: ignore[reportUnknownVariableType]
            else:
                assert target.mapping is not None
                _check_fields(message, topic.type)
                value = target.mapping.value(message)
            body = msgspec.Raw(msgspec.json.encode(value))
        if target.kind == "action":
            return Request(type="execute", path=target.path, body=body)
        valid = self._context.config.valid_for if target.expires else None
        return Request(type="write", path=target.path, body=body, valid_for=valid)

    def _next(self, outlet: _Outlet, target: Target | None) -> None:
        """Send the next message; of velocities the newest, because it replaces the others."""
        outlet.busy = False
        waiting = outlet.waiting
        if target is not None and target.expires:
            while len(waiting) > 1:
                self._size -= len(waiting.popleft()[0].msg)
        if waiting and not self._context.connection.closed:
            op, received = waiting.popleft()
            self._size -= len(op.msg)
            outlet.busy = True
            self._context.client_api.turns.call(
                self._context.owner, lambda: self._send(op, outlet, received)
            )

    def _failed(self, topic: str, id_: str | None, error: RcpError) -> None:
        self._context.status.error(f"{topic}: {sentence(error)}", id_, f"{topic} {error.code}")

    def _refused(self, topic: str, id_: str | None, error: dict[str, Any]) -> None:
        text = f"{topic}: {error['message']}"
        if error.get("remedy"):
            text = f"{text.removesuffix('.')}. {error['remedy']}"
        self._context.status.error(text, id_, f"{topic} {error['code']}")


def _check_fields(message: Any, type_: str) -> None:
    """Refuse what is not a message of a common type.

    :raises BadRequest: it is no object, or has an unknown field.
    """
    if not isinstance(message, dict):
        raise BadRequest(f"a message of {type_} is an object", remedy=_REMEDY)
    known = message_type(type_)
    names = () if known is None else tuple(field.name for field in known.fields)
    for name in message:  # pyright: ignore[reportUnknownVariableType]
        if known is not None and name not in names:
            text = f"{type_} has no field '{name}'; it has {', '.join(names)}"
            raise BadRequest(text, remedy=_REMEDY)


def _nobody(name: str, topic: RosTopic | None) -> str:
    if topic is not None and topic.feed is not None:
        return f"{name} is published by the robot, and takes no messages"
    return f"nothing takes messages on {name}, so they have no effect"
