"""The operations of rosbridge v2 as types; decoding validates them."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta, Raw

from rcp_kernel.errors import BadRequest
from rcp_rosbridge.config import Level

__all__ = [
    "ActionFeedback",
    "ActionResult",
    "Advertise",
    "AdvertiseAction",
    "AdvertiseService",
    "Auth",
    "CallService",
    "CancelActionGoal",
    "Compression",
    "Fragment",
    "Operation",
    "Png",
    "Publish",
    "SendActionGoal",
    "ServiceResponse",
    "SetLevel",
    "Subscribe",
    "Unadvertise",
    "UnadvertiseAction",
    "UnadvertiseService",
    "Unsubscribe",
    "decode",
    "id_of",
]

Id = Annotated[str, Meta(max_length=256)] | int | float | None
Name = Annotated[str, Meta(min_length=1, max_length=512)]
Compression = Literal["none", "png", "cbor", "cbor-raw"]
_Milliseconds = Annotated[float, Meta(ge=0)]
_Size = Annotated[float, Meta(ge=0)]


class _Op(msgspec.Struct, frozen=True, kw_only=True, tag_field="op", rename={"id_": "id"}):
    id_: Id = None


class Advertise(_Op, frozen=True, tag="advertise"):
    """A client will publish on a topic."""

    topic: Name
    type: str | None = None


class Unadvertise(_Op, frozen=True, tag="unadvertise"):
    """It no longer will."""

    topic: Name


class Publish(_Op, frozen=True, tag="publish"):
    """A message on a topic."""

    topic: Name
    msg: Raw = Raw(b"{}")


class Subscribe(_Op, frozen=True, tag="subscribe"):
    """A client wants the messages of a topic."""

    topic: Name
    type: str | None = None
    throttle_rate: _Milliseconds | None = None
    queue_length: _Size | None = None
    fragment_size: _Size | None = None
    compression: Compression | None = None


class Unsubscribe(_Op, frozen=True, tag="unsubscribe"):
    """It no longer does; without an id, none of its subscriptions to the topic."""

    topic: Name


class CallService(_Op, frozen=True, tag="call_service"):
    """A call of a service."""

    service: Name
    type: str | None = None
    args: Raw = Raw()
    fragment_size: _Size | None = None
    compression: str | None = None
    timeout: float | None = None


class SendActionGoal(_Op, frozen=True, tag="send_action_goal"):
    """A goal of an action."""

    action: Name
    action_type: str | None = None
    args: Raw = Raw()
    feedback: bool = False
    fragment_size: _Size | None = None
    compression: str | None = None


class CancelActionGoal(_Op, frozen=True, tag="cancel_action_goal"):
    """Cancel a goal, by the id of its operation."""

    action: Name


class AdvertiseService(_Op, frozen=True, tag="advertise_service"):
    """A client offers a service."""

    service: Name
    type: str | None = None


class UnadvertiseService(_Op, frozen=True, tag="unadvertise_service"):
    """It no longer does."""

    service: Name


class ServiceResponse(_Op, frozen=True, tag="service_response"):
    """The response of a service that a client offers."""

    service: Name
    values: Raw = Raw()
    result: bool = True


class AdvertiseAction(_Op, frozen=True, tag="advertise_action"):
    """A client offers an action."""

    action: Name
    type: str | None = None


class UnadvertiseAction(_Op, frozen=True, tag="unadvertise_action"):
    """It no longer does."""

    action: Name


class ActionFeedback(_Op, frozen=True, tag="action_feedback"):
    """Feedback of an action that a client offers."""

    action: Name
    values: Raw = Raw()


class ActionResult(_Op, frozen=True, tag="action_result"):
    """The result of an action that a client offers; `status` is that of action_msgs/GoalStatus."""

    action: Name
    values: Raw = Raw()
    status: int | None = None
    result: bool = True


class Fragment(_Op, frozen=True, tag="fragment"):
    """A part of the text of a message."""

    data: str
    num: float
    total: float


class Png(_Op, frozen=True, tag="png"):
    """A message as a picture."""

    data: str


class SetLevel(_Op, frozen=True, tag="set_level"):
    """Which status messages a client wants."""

    level: Level


class Status(_Op, frozen=True, tag="status"):
    """A status message of a client."""


class Auth(_Op, frozen=True, tag="auth"):
    """Credentials: `token`, or `mac` as clients made for rosauth call it."""

    token: Annotated[str, Meta(max_length=16_384)] | None = None
    mac: Annotated[str, Meta(max_length=16_384)] | None = None


Operation = (
    Publish
    | Advertise
    | Unadvertise
    | Subscribe
    | Unsubscribe
    | CallService
    | SendActionGoal
    | CancelActionGoal
    | AdvertiseService
    | UnadvertiseService
    | ServiceResponse
    | AdvertiseAction
    | UnadvertiseAction
    | ActionFeedback
    | ActionResult
    | Fragment
    | Png
    | SetLevel
    | Status
    | Auth
)


class _Head(msgspec.Struct):
    op: str | None = None
    id: Id = None


_decoder = msgspec.json.Decoder(Operation)
_head = msgspec.json.Decoder(_Head)
_NAMES = tuple(sorted(str(one.__struct_config__.tag) for one in get_args(Operation)))
_REMEDY = "Send one JSON object, as rosbridge v2 describes it."
_PEEKED = 65_536  # bytes beyond which a message is not parsed to answer that it is malformed


def decode(data: bytes | str) -> Operation:
    """Decode one message.

    :raises BadRequest: it is not an operation, with the reason.
    """
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        reason = str(error)
    op = None
    if len(data) <= _PEEKED:
        try:
            op = _head.decode(data).op
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            text = f"the message is not an operation of rosbridge: {reason}"
            raise BadRequest(text, remedy=_REMEDY) from None
    if op is not None and op not in _NAMES:
        raise BadRequest(
            f"unknown operation {op[:64]!r}", remedy=f"Use one of {', '.join(_NAMES)}."
        )
    raise BadRequest(f"malformed {op or 'operation'}: {reason}", remedy=_REMEDY)


def id_of(data: bytes | str) -> str | None:
    """Return the id of a message that could not be decoded, if that can be."""
    if len(data) > _PEEKED:
        return None
    try:
        found = _head.decode(data).id
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return None if found is None else str(found)
