"""Service resources."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any

import msgspec

from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.caller import Caller
from rcp_ros2.cdr import Codec, Malformed
from rcp_ros2.config import Mapping
from rcp_ros2.filler import filler
from rcp_ros2.idl import Primitive, Text, Type, fields_of
from rcp_ros2.made import is_made
from rcp_ros2.native import native_type
from rcp_ros2.types import example_of, inward
from rcp_ros2.writer import writer

__all__ = ["Called", "reader"]

_MARGIN = 1.0  # s that the gateway waits longer than the service may take
_READING = {
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
    "tf2_msgs/srv/FrameGraph",
    "type_description_interfaces/srv/GetTypeDescription",
}
"""Service types that change nothing."""
_HARMLESS = _READING | {"rcl_interfaces/srv/SetLoggerLevels", "sensor_msgs/srv/SetCameraInfo"}
"""Service types that move nothing; any other may move the robot."""


def reader(codec: Codec) -> Callable[[Any], Any]:
    """Return a function that converts a message object to a typed value.

    :raises Malformed: from that function: what arrived was not a message of its type.
    """
    if is_made(codec.cls):
        return _read_made(codec)
    if (copy := _copier(codec)) is not None:
        return copy
    from rclpy.serialization import serialize_message

    return lambda message: codec.decode(serialize_message(message))


def _copier(codec: Codec) -> Callable[[Any], Any] | None:
    """Return a function that copies the fields, in a twentieth of the time; None: not all are plain."""
    fields, make = fields_of(codec.cls), codec.type
    if len(fields) < 2 or not all(_is_plain(field.type) for field in fields):
        return None
    values = attrgetter(*(field.name for field in fields))
    return lambda message: make(*values(message))


def _is_plain(type_: Type) -> bool:
    """Return whether rclpy has a field as the decoder returns it."""
    match type_:
        case Primitive(name):
            return name != "octet"
        case Text(_, wide):
            return not wide
        case _:
            return False


def _read_made(codec: Codec) -> Callable[[Any], Any]:
    encode = writer(codec.cls)

    def read(message: Any) -> Any:
        if isinstance(message, codec.cls):  # see `carrier.py`
            raise Malformed(f"the answer is not a valid {codec.name}")
        return codec.decode(encode(message))

    return read


class Called(Binding):
    """A service resource."""

    def __init__(self, shared: Shared, name: str, mapping: Mapping, srv: Any) -> None:
        request, response = srv.Request, srv.Response
        fields = fields_of(request)
        self._input = inward(request, mapping.unit, nan=mapping.nan) if fields else None
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
            hints=READS["hints"] if type_name in _READING else None,
        )
        facts["timeout"] = (mapping.timeout or shared.config.timeout) + _MARGIN
        facts["moves"] = moves
        resource = Resource(
            input=self._input,
            output=None if empty else Codec(response, unit=mapping.unit).type,
            native_types={
                "input": native_type(request),
                "output": native_type(response, written=True),
            },
            examples=example_of(self._input) if self._input else (),
            **facts,
        )
        super().__init__(shared, resource, mapping)

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Call the service.

        :raises DeviceRejected: the response contains `success: false`.
        """
        request = self._request() if value is None else self._fill(value)
        result = await self._caller.call(request, self.timeout)
        if getattr(result, "success", None) is False:
            if self.is_barred:
                progress()  # it may have begun to move before it failed
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
