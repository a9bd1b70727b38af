"""The JSON messages of clients, as types, and the errors of those that are none."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import BadRequest, PayloadTooLarge

__all__ = [
    "Advertise",
    "ClientChannel",
    "FetchAsset",
    "GetParameters",
    "Operation",
    "Parameter",
    "SetParameters",
    "Subscribe",
    "SubscribeConnectionGraph",
    "SubscribeParameterUpdates",
    "Unadvertise",
    "Unsubscribe",
    "UnsubscribeConnectionGraph",
    "UnsubscribeParameterUpdates",
    "decode_operation",
]

_LONGEST = 1_048_576  # bytes of one operation: it is decoded in one step
Number = Annotated[int, Meta(ge=0, le=2**32 - 1)]
"""An id that clients or the gateway choose; binary messages have it in four bytes."""
Name = Annotated[str, Meta(max_length=1024)]
Names = Annotated[list[Name], Meta(max_length=20_000)]
Numbers = Annotated[list[Number], Meta(max_length=20_000)]


class _Op(msgspec.Struct, frozen=True, tag_field="op", rename="camel"):
    """One operation; fields that it does not know are ignored, as the protocol grows by them."""


class Wish(msgspec.Struct, frozen=True, rename="camel"):
    """A subscription of a channel."""

    id: Number
    channel_id: Number


class Subscribe(_Op, frozen=True, tag="subscribe"):
    """Begin subscriptions."""

    subscriptions: Annotated[list[Wish], Meta(max_length=20_000)]


class Unsubscribe(_Op, frozen=True, tag="unsubscribe"):
    """End subscriptions."""

    subscription_ids: Numbers


class ClientChannel(msgspec.Struct, frozen=True, rename="camel"):
    """A channel on which a client publishes."""

    id: Number
    topic: Name
    encoding: Name
    schema_name: Name = ""


class Advertise(_Op, frozen=True, tag="advertise"):
    """Begin to publish."""

    channels: Annotated[list[ClientChannel], Meta(max_length=1000)]


class Unadvertise(_Op, frozen=True, tag="unadvertise"):
    """End to publish."""

    channel_ids: Numbers


class Parameter(msgspec.Struct, frozen=True):
    """A parameter with its value; without one it is to be unset."""

    name: Name
    value: Any = msgspec.UNSET
    type: Literal["byte_array", "float64", "float64_array"] | None = None


class GetParameters(_Op, frozen=True, tag="getParameters"):
    """Read parameters; without names, all of them."""

    parameter_names: Names = []
    id: Name | None = None


class SetParameters(_Op, frozen=True, tag="setParameters"):
    """Write parameters."""

    parameters: Annotated[list[Parameter], Meta(max_length=1000)]
    id: Name | None = None


class SubscribeParameterUpdates(_Op, frozen=True, tag="subscribeParameterUpdates"):
    """Follow parameters; without names, all of them."""

    parameter_names: Names = []


class UnsubscribeParameterUpdates(_Op, frozen=True, tag="unsubscribeParameterUpdates"):
    """Stop to follow parameters; without names, all of them."""

    parameter_names: Names = []


class SubscribeConnectionGraph(_Op, frozen=True, tag="subscribeConnectionGraph"):
    """Follow who publishes, subscribes and serves."""


class UnsubscribeConnectionGraph(_Op, frozen=True, tag="unsubscribeConnectionGraph"):
    """Stop to follow it."""


class FetchAsset(_Op, frozen=True, tag="fetchAsset"):
    """Read a file of a robot's description."""

    uri: Name
    request_id: Number


Operation = (
    Subscribe
    | Unsubscribe
    | Advertise
    | Unadvertise
    | GetParameters
    | SetParameters
    | SubscribeParameterUpdates
    | UnsubscribeParameterUpdates
    | SubscribeConnectionGraph
    | UnsubscribeConnectionGraph
    | FetchAsset
)
_decoder = msgspec.json.Decoder(Operation)


def decode_operation(data: bytes) -> Operation:
    """Decode a JSON message.

    :raises BadRequest: it is not an operation, or one that does not exist.
    :raises PayloadTooLarge: it is too long for one.
    """
    if len(data) > _LONGEST:
        raise PayloadTooLarge(
            f"an operation of {len(data)} bytes is too long: the limit is {_LONGEST}",
            remedy="Split it into several operations.",
        )
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise BadRequest(f"not a valid operation: {str(error)[:300]}") from None
