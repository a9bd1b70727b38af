"""Node parameters: described with their ranges, set, or refused with a reason, by the node."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from msgspec import Meta

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, RcpError
from rcp_kernel.model import Operation, Resource
from rcp_kernel.types import NONFINITE
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.caller import Caller
from rcp_ros2.config import Mapping
from rcp_ros2.names import is_internal_parameter
from rcp_ros2.ros import one_argument

__all__ = ["Described", "Events", "NodeParameters", "Setting"]

_FIELDS = {
    1: "bool_value",
    2: "integer_value",
    3: "double_value",
    4: "string_value",
    5: "byte_array_value",
    6: "bool_array_value",
    7: "integer_array_value",
    8: "double_array_value",
    9: "string_array_value",
}
"""rcl_interfaces/msg/ParameterType, with the field of ParameterValue that holds the value."""
Admit = Callable[[], None]
_INT: dict[str, Any] = {"ge": -(2**63), "le": 2**63 - 1}


class Described(NamedTuple):
    """A node's description of one of its parameters."""

    name: str
    kind: int
    text: str
    read_only: bool
    bounds: dict[str, Any]

    def type(self, unit: str | None) -> Any:
        """Return the type of the values; numbers have the unit `unit`."""
        extra: Any = {} if unit is None else {"unit": unit}
        match self.kind:
            case 1 | 6:
                plain_type: Any = bool
            case 2 | 7:
                plain_type = Annotated[int, Meta(**(_INT | self.bounds), extra_json_schema=extra)]
            case 3 | 8:
                if not self.bounds:  # NaN is a common marker for an unset parameter
                    extra[NONFINITE] = True
                plain_type = Annotated[float, Meta(**self.bounds, extra_json_schema=extra)]
            case 4 | 9:
                plain_type = str
            case _:
                return bytes
        return list[plain_type] if self.kind > 5 else plain_type


class NodeParameters:
    """The parameter services of one node."""

    def __init__(self, shared: Shared, node: str) -> None:
        from rcl_interfaces import srv

        self.node = node
        self._shared = shared
        self._srv = srv
        self._callers: dict[Any, Caller] = {}

    async def _call(self, srv: Any, name: str, admit: Admit | None = None, **request: Any) -> Any:
        caller = self._callers.get(srv)
        if caller is None:
            address = f"{self.node}/{name}"
            caller = self._callers[srv] = Caller(
                self._shared, srv, address, presence=("node", self.node)
            )
        return await caller.call(srv.Request(**request), self._shared.config.timeout, admit)

    async def names(self) -> list[str]:
        """List the node's parameters, except the standard ones of every node."""
        response = await self._call(self._srv.ListParameters, "list_parameters")
        return [n for n in response.result.names if not is_internal_parameter(n)]

    async def describe(self, names: list[str]) -> list[Described]:
        """Return type, range and text of parameters; those without a type so far are omitted."""
        response = await self._call(
            self._srv.DescribeParameters, "describe_parameters", names=names
        )
        return [_described(d) for d in response.descriptors if d.type in _FIELDS]

    async def get(self, name: str, kind: int) -> Any:
        """Return the current value; None if the node has no such parameter of this kind."""
        response = await self._call(self._srv.GetParameters, "get_parameters", names=[name])
        # If one of several names is not declared, rclpy returns an empty list.
        if len(response.values) != 1 or response.values[0].type != kind:
            return None
        return plain(response.values[0])

    async def set(self, name: str, kind: int, value: Any, admit: Admit) -> None:
        """Set a parameter; `admit` is called in the ROS thread just before, and raises to refuse it.

        :raises DeviceRejected: the node refused, with its reason.
        """
        response = await self._call(
            self._srv.SetParameters,
            "set_parameters",
            admit,
            parameters=[_wrapped(name, kind, value)],
        )
        self._check(response.results[0] if response.results else None, f"set '{name}'")

    async def set_together(self, values: dict[str, tuple[int, Any]], admit: Admit) -> None:
        """Set several parameters, given with their types: all of them or none; `admit` as above.

        :raises DeviceRejected: the node refused, with its reason.
        """
        response = await self._call(
            self._srv.SetParametersAtomically,
            "set_parameters_atomically",
            admit,
            parameters=[_wrapped(name, kind, value) for name, (kind, value) in values.items()],
        )
        self._check(response.result, f"set {', '.join(values)} together")

    def _check(self, result: Any, what: str) -> None:
        if result is None or not result.successful:
            why = result.reason if result is not None and result.reason else "no reason given"
            raise DeviceRejected(f"{self.node} refused to {what}: {why}")

    def close(self) -> None:
        """Destroy the clients."""
        for caller in self._callers.values():
            caller.close()


def _wrapped(name: str, kind: int, value: Any) -> Any:
    from rcl_interfaces.msg import Parameter, ParameterValue

    if kind == 5:
        value = [bytes((one,)) for one in value]
    return Parameter(name=name, value=ParameterValue(type=kind, **{_FIELDS[kind]: value}))


def plain(value: Any) -> Any:
    """Return the value in a ParameterValue."""
    found = getattr(value, _FIELDS[value.type])
    if value.type == 5:
        return b"".join(found)
    return list(found) if value.type > 5 else found


def _described(descriptor: Any) -> Described:
    text = descriptor.description.strip().rstrip(".")
    if descriptor.additional_constraints:
        text = (
            f"{text}; {descriptor.additional_constraints.strip()}"
            if text
            else (descriptor.additional_constraints.strip())
        )
    limits: dict[str, Any] = {}
    if descriptor.type == 2 and descriptor.integer_range:
        bounds = descriptor.integer_range[0]
        step = bounds.step if bounds.step > 1 and bounds.from_value % bounds.step == 0 else None
        limits = {"ge": bounds.from_value, "le": bounds.to_value, "multiple_of": step}
    if descriptor.type == 3 and descriptor.floating_point_range:
        bounds = descriptor.floating_point_range[0]
        limits = {"ge": bounds.from_value, "le": bounds.to_value}
        if bounds.step:
            text = f"{text} (in steps of {bounds.step:g})".strip()
    return Described(descriptor.name, descriptor.type, text, descriptor.read_only, limits)


class Events:
    """Parameter events of the nodes in the graph."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._listeners: dict[tuple[str, str], set[Callable[[Any], None]]] = {}
        """By node and parameter: several paths may be one parameter."""
        self._followers: dict[str, Callable[[dict[str, int]], None]] = {}
        self._subscription: Any = None

    def follow(self, node: str, on_change: Callable[[dict[str, int]], None]) -> None:
        """Call a function on the event loop with the names and types of changed parameters.

        Type 0 is a parameter that was removed.
        """
        self._followers[node] = on_change
        self._shared.ros.post(self._open)

    def leave(self, node: str) -> None:
        """Unsubscribe."""
        if self._followers.pop(node, None) is not None:
            self._shared.ros.post(self._close)

    def lost(self, node: str, parameter: str) -> None:
        """Notify the followers of a node that a parameter no longer exists."""
        self._shared.host.call_soon(self._follow, node, {parameter: 0})

    def listen(self, node: str, parameter: str, on_change: Callable[[Any], None]) -> None:
        """Call a function, on the event loop, with each new ParameterValue."""
        self._listeners.setdefault((node, parameter), set()).add(on_change)
        self._shared.ros.post(self._open)

    def ignore(self, node: str, parameter: str, on_change: Callable[[Any], None]) -> None:
        """Unsubscribe."""
        listeners = self._listeners.get((node, parameter), set())
        listeners.discard(on_change)
        if not listeners and self._listeners.pop((node, parameter), None) is not None:
            self._shared.ros.post(self._close)

    def _open(self) -> None:
        if self._subscription is not None:
            return
        from rcl_interfaces.msg import ParameterEvent
        from rclpy.event_handler import SubscriptionEventCallbacks
        from rclpy.qos import qos_profile_parameter_events

        self._subscription = self._shared.ros.node.create_subscription(
            ParameterEvent,
            "/parameter_events",
            one_argument(self._on_event),
            qos_profile_parameter_events,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def _close(self) -> None:
        if self._subscription is not None and not self._listeners and not self._followers:
            self._shared.ros.node.destroy_subscription(self._subscription)
            self._subscription = None

    def _on_event(self, event: Any) -> None:
        on_change = (*event.new_parameters, *event.changed_parameters)
        if event.node in self._followers:
            kinds = {p.name: p.value.type for p in on_change}
            kinds |= {p.name: 0 for p in event.deleted_parameters}
            self._shared.host.call_soon(self._follow, event.node, kinds)
        for parameter in on_change:
            if (event.node, parameter.name) in self._listeners:
                self._shared.host.call_soon(
                    self._notify, event.node, parameter.name, parameter.value
                )

    def _follow(self, node: str, kinds: dict[str, int]) -> None:
        follower = self._followers.get(node)
        if follower is not None:
            follower(kinds)

    def _notify(self, node: str, name: str, value: Any) -> None:
        for on_change in tuple(self._listeners.get((node, name), ())):
            on_change(value)


class Setting(Binding):
    """A parameter resource."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        mapping: Mapping,
        node: NodeParameters,
        described: Described,
        events: Events,
    ) -> None:
        self._node = node
        self.described = described
        self._events = events
        self._first: asyncio.Future[None] | None = None
        text = described.text or f"Parameter {described.name} of {node.node}"
        facts = common(name, mapping, text, node=node.node, parameter=described.name)
        if described.read_only:
            facts["operations"] = Operation.READ | Operation.SUBSCRIBE
        else:
            facts["atomic"] = f"parameters of {node.node}"
        super().__init__(shared, Resource(value=described.type(mapping.unit), **facts), mapping)

    @property
    def node(self) -> NodeParameters:
        """The node that has it."""
        return self._node

    async def read(self) -> Any:
        """Read the parameter from the node.

        :raises AdapterUnavailable: the parameter no longer exists, or the node is not running.
        """
        value = await self._node.get(self.described.name, self.described.kind)
        if value is None:  # not every node announces removed parameters
            name = self.described.name
            self._events.lost(self._node.node, name)
            raise AdapterUnavailable(f"{self._node.node} no longer has a parameter '{name}'")
        return value

    async def write(self, value: Any) -> Any:
        """Set the parameter on the node; return the resulting value."""
        await self._node.set(self.described.name, self.described.kind, value, self.admit)
        return None

    def watched(self, rate: float) -> None:
        """Publish each change that the node reports."""
        self._events.listen(self._node.node, self.described.name, self._changed)
        if self._first is None:
            self._first = asyncio.ensure_future(self._publish_present())

    async def _publish_present(self) -> None:
        with contextlib.suppress(RcpError):  # a node that is down publishes it when back
            self.shared.host.publish(self.resource.name, await self.read())

    def unwatched(self) -> None:
        """Stop publishing."""
        self._events.ignore(self._node.node, self.described.name, self._changed)
        if self._first is not None:
            self._first.cancel()
            self._first = None

    def _changed(self, value: Any) -> None:
        if value.type == self.described.kind:
            self.shared.host.publish(self.resource.name, plain(value))

    def close(self) -> None:
        """Stop publishing."""
        self.unwatched()
