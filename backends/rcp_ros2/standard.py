"""Sensors, velocity and parameters as resources of the profiles."""

from __future__ import annotations

from typing import Any

from msgspec import structs

from rcp_kernel.model import NativeType, Resource
from rcp_kernel.types import Twist
from rcp_profiles import STANDARD, bounded, twist_limits
from rcp_ros2.binding import Shared
from rcp_ros2.config import Mapping
from rcp_ros2.filler import filler
from rcp_ros2.idl import full_name
from rcp_ros2.native import native_type
from rcp_ros2.parameters import Described, Events, NodeParameters, Setting
from rcp_ros2.sensors import Commanded, Form, Observed
from rcp_ros2.shapes import SHAPES, Shaped, joints_of

__all__ = ["Driven", "SpeedLimit", "defined", "observed", "standard_value"]

_DEFINED = {
    definition.name: definition.resource
    for profile in STANDARD.values()
    for definition in profile.resources
}
_KEPT = ("description", "deadline", "timeout", "policy", "max_age", "history")


def defined(name: str, standard: str, mapping: Mapping, **own: Any) -> Resource:
    """Return a resource of a profile under its path, with what its mapping sets."""
    kept = {key: value for key in _KEPT if (value := getattr(mapping, key)) is not None}
    return structs.replace(_DEFINED[standard], name=name, **(own | kept))


def standard_value(standard: str) -> Any:
    """Return the type of a profile's values."""
    return _DEFINED[standard].value


def observed(
    shared: Shared,
    name: str,
    standard: str,
    mapping: Mapping,
    cls: Any,
    joints: tuple[str, ...] = (),
) -> Observed:
    """Create a sensor of a profile; of joint states, only those of some `joints`."""
    codec = Shaped(cls, joints_of(joints) if joints else SHAPES[standard])
    own = Observed.of(shared, name, mapping, cls).resource
    resource = defined(
        name,
        standard,
        mapping,
        value=codec.type,
        native=own.native,
        native_types=own.native_types,
        meta=own.meta,
    )
    if SHAPES[standard].whole:  # the profile's examples lack the message's own fields
        resource = structs.replace(resource, examples=())
    made = Observed(shared, structs.replace(resource, timeout=own.timeout), mapping, cls, codec)
    made.standard = standard
    return made


class Driven(Commanded):
    """The velocity of a base, as Twist or TwistStamped, whichever the graph has."""

    def __init__(
        self, shared: Shared, name: str, standard: str, mapping: Mapping, cls: Any
    ) -> None:
        limits = shared.config.limits
        type_ = Twist
        if limits is not None:
            bounds = twist_limits(x=limits.speed, y=limits.sideways, yaw=limits.turn)
            type_ = bounded(Twist, bounds)
        super().__init__(shared, name, mapping, cls, _form(cls, type_))
        own = self.resource
        examples = () if limits is not None else _DEFINED[standard].examples
        resource = defined(
            name,
            standard,
            mapping,
            value=own.value,
            valid_for=own.valid_for,
            safe=own.safe,
            native=own.native,
            native_types={"value": _native_twist(cls)},
            meta=own.meta,
            examples=examples,
        )
        self.resource = structs.replace(resource, moves=own.moves, energises=own.energises)
        self.standard = standard


def _native_twist(cls: Any) -> NativeType:
    native = native_type(cls)
    decode = native.decode
    if full_name(cls) == "geometry_msgs/msg/Twist" or decode is None:
        return native
    return structs.replace(native, decode=lambda data: decode(data).twist)


def _form(cls: Any, type_: Any) -> Form:
    if full_name(cls) == "geometry_msgs/msg/Twist":
        return Form(type_, filler(cls))
    fill = filler(type(cls().twist))

    def stamped(value: Any) -> Any:
        message = cls(twist=fill(value))
        message.header.frame_id = "base_link"
        return message

    return Form(type_, stamped)


class SpeedLimit(Setting):
    """A parameter that is a robot's speed limit."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        standard: str,
        mapping: Mapping,
        node: NodeParameters,
        described: Described,
        events: Events,
    ) -> None:
        super().__init__(shared, name, mapping, node, described, events)
        bounds = (max(0.0, described.bounds.get("ge", 0.0)), described.bounds.get("le"))
        value = bounded(_DEFINED[standard].value, {"": bounds})
        self.resource = defined(
            name,
            standard,
            mapping,
            value=value,
            operations=self.resource.operations,
            atomic=self.resource.atomic,
            meta=self.resource.meta,
            examples=(),
        )
        self.standard = standard
