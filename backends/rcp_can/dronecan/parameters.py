"""The parameters of a node: listed by number, read and written by name."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta

from rcp_can.dronecan.library import make, text_of, transport
from rcp_can.dronecan.port import Port
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, UnknownPath

__all__ = ["Parameter", "Parameters", "Setting", "decoded", "parameter_type"]

_MOST = 2048  # parameters of a node
Setting = int | float | bool | str
Kind = Literal["integer_value", "real_value", "boolean_value", "string_value"]
_EMPTY = "empty"


class Parameter(NamedTuple):
    """One parameter as its node lists it."""

    name: str
    kind: Kind
    value: Setting
    default: Setting | None
    low: float | None
    high: float | None


def parameter_type(parameter: Parameter) -> Any:
    """Return the type of a parameter's value, with the bounds that its node tells."""
    match parameter.kind:
        case "boolean_value":
            return bool
        case "string_value":
            return Annotated[str, Meta(max_length=128)]
        case "integer_value":
            bare = int
        case "real_value":
            bare = float
    bounds = Meta(ge=parameter.low, le=parameter.high, extra_json_schema={"unit": "1"})
    return Annotated[bare, bounds]  # pyright: ignore[reportInvalidTypeForm]


class Parameters:
    """The parameters of one node."""

    def __init__(self, port: Port, node: int) -> None:
        self._port, self._node = port, node

    async def list(self) -> list[Parameter]:
        """Ask for each by its number, until there is none.

        :raises DeviceTimeout: the node does not answer.
        """
        found: dict[str, Parameter] = {}
        for index in range(_MOST):
            parameter = decoded(await self._ask(f"parameter {index}", index=index))
            if parameter is None or parameter.name in found:  # it does not heed the number
                break
            found[parameter.name] = parameter
        return list(found.values())

    async def read(self, name: str) -> Setting:
        """Return the value that the node has.

        :raises DeviceTimeout: the node does not answer.
        :raises UnknownPath: the node has it no longer.
        """
        return self._known(name, await self._ask(name, name=name)).value

    async def write(
        self, name: str, kind: Kind, value: Setting, before: Callable[[], None]
    ) -> Setting:
        """Write a value; return the one that the node has afterwards.

        `before` is called right before it is sent, and raises to refuse it.

        :raises DeviceRejected: the node kept another one.
        :raises DeviceTimeout: the node does not answer.
        :raises UnknownPath: the node has it no longer.
        """
        plain: Any = int(value) if kind == "boolean_value" else value
        wanted = make("protocol.param.Value", **{kind: plain})
        # Once: by the time of a second request its motor may turn.
        request = make("protocol.param.GetSet.Request", name=name, value=wanted)
        answer = await self._port.request(
            self._node, request, f"for {name}", attempts=1, before=before
        )
        now = self._known(name, answer).value
        if not _same(kind, now, value):
            raise DeviceRejected(
                f"DroneCAN node {self._node} has {name} = {now!r} after {value!r} was written",
                details={"value": now},
            )
        return now

    async def _ask(self, what: str, **fields: Any) -> Any:
        request = make("protocol.param.GetSet.Request", **fields)
        return await self._port.request(self._node, request, f"for {what}")

    def _known(self, name: str, response: Any) -> Parameter:
        parameter = decoded(response)
        if parameter is None:
            raise UnknownPath(f"DroneCAN node {self._node} has no parameter {name}")
        if parameter.name != name:
            raise DeviceTimeout(
                f"DroneCAN node {self._node} answered for {parameter.name}, not for {name}"
            )
        return parameter


def decoded(response: Any) -> Parameter | None:
    """Return the parameter of a response; None: there is no such parameter."""
    name, (kind, value) = text_of(response.name), _value(response.value)
    if not name or value is None:
        return None
    low, high = _bounds(kind, value, response)
    return Parameter(name, kind, value, _value(response.default_value)[1], low, high)


def _bounds(kind: Kind, value: Any, response: Any) -> tuple[float | None, float | None]:
    """Return the bounds of a number; none if they contradict its value or each other."""
    low, high = (_value(bound)[1] for bound in (response.min_value, response.max_value))
    if kind not in ("integer_value", "real_value"):
        return None, None
    if kind == "integer_value":  # a node may tell bounds of another kind
        low, high = (bound if type(bound) is int else None for bound in (low, high))
    given = [bound for bound in (low, value, high) if bound is not None]
    sound = all(map(math.isfinite, given)) and given == sorted(given) and low != high
    return (low, high) if sound and (low, high) != (None, None) else (None, None)


def _value(union: Any) -> tuple[Any, Any]:
    kind = transport.get_active_union_field(union) or _EMPTY
    if kind == _EMPTY:
        return kind, None
    value = getattr(union, kind)
    if kind == "string_value":
        return kind, text_of(value)
    return kind, bool(value) if kind == "boolean_value" else value


def _same(kind: Kind, now: Setting, wanted: Setting) -> bool:
    if kind == "real_value":
        return struct.pack("<f", now) == struct.pack("<f", wanted)
    return now == wanted
