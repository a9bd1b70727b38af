"""Observed service calls of any client, if the node has introspection enabled."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from functools import partial
from typing import Any, Literal

import msgspec

from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.graph import CALLS, Graph
from rcp_ros2.idl import load
from rcp_ros2.sensors import Observed
from rcp_ros2.types import outward

__all__ = ["Calls", "calls_of"]

Step = Literal["request_sent", "request_received", "response_sent", "response_received"]
_STEPS: tuple[Step, ...] = Step.__args__
"""Event types by their number in service_msgs/msg/ServiceEventInfo."""


def _call_type(srv: Any) -> type[msgspec.Struct]:
    """Return the type of one call event; its contents are optional, as the node may omit them."""
    return msgspec.defstruct(
        f"{srv.__name__}Call",
        [
            ("step", Step),
            ("client", bytes),
            ("number", int),
            ("request", outward(srv.Request) | None, None),
            ("response", outward(srv.Response) | None, None),
        ],
        frozen=True,
    )


class _Steps(Codec):
    """Decodes the event type that rosidl generates for a service."""

    def __init__(self, srv: Any, event: Any) -> None:
        super().__init__(event)
        self.type = _call_type(srv)

    def decode(self, data: bytes) -> Any:
        """Return one call event."""
        event = super().decode(data)
        info = event.info
        return self.type(
            step=_STEPS[info.event_type % len(_STEPS)],
            client=bytes(info.client_gid),
            number=info.sequence_number,
            request=next(iter(event.request), None),
            response=next(iter(event.response), None),
        )

    def stamp(self, data: bytes) -> int | None:
        """Return the time of the event, ns since the epoch."""
        stamp = super().decode(data).info.stamp
        return stamp.sec * 1_000_000_000 + stamp.nanosec or None


class Calls:
    """Provides the calls of each exposed service with introspection."""

    def __init__(self, shared: Shared, services: AbstractSet[str]) -> None:
        self._shared = shared
        self._services = services
        """A live set, maintained by the catalog."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return an event resource for each service with introspection enabled."""
        found: dict[str, Offer] = {}
        for service in self._services:
            type_ = graph.services.get(service)
            if type_ and graph.publishers.get(f"{service}{CALLS}"):
                name = self._shared.naming.path("event", service, before=("calls",))
                mapping = Mapping(service=service)
                found[name] = Offer(mapping, partial(calls_of, self._shared, name, mapping, type_))
        return found


def calls_of(shared: Shared, name: str, mapping: Mapping, type_: str) -> Binding:
    """Create the event resource of a service's calls; called in the ROS thread.

    :raises MissingType: the service's type is not installed.
    """
    service = mapping.target
    event = load(f"{type_}_Event", "srv")
    text = f"Calls of service {service} and their responses, from any client."
    facts = common(name, mapping, text, service=service, type=type_)
    codec = _Steps(load(type_, "srv"), event)
    resource = Resource(value=codec.type, native=f"{type_}_Event", live=True, **facts)
    observed = msgspec.structs.replace(mapping, service=None, topic=f"{service}{CALLS}")
    return Observed(shared, resource, observed, event, codec)
