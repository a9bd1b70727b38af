"""What a fleet manager sends about zones (3.0): zone sets, and responses to requests."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_vda5050.messages import Addressed, Blocking, Name, Parameter

__all__ = ["Response", "Responses", "Vertex", "Zone", "ZoneAction", "ZoneSet", "ZoneSetMessage"]

MOST_ZONES = 1000
_MOST_ACTIONS = 100


class Vertex(Struct, frozen=True):
    """One corner of a zone, m."""

    x: float
    y: float


class ZoneAction(Struct, frozen=True, rename="camel"):
    """An action of a zone, without an id: the robot gives it one each time."""

    action_type: Name
    blocking_type: Blocking
    action_parameters: Annotated[tuple[Parameter, ...], Meta(max_length=_MOST_ACTIONS)] = ()


ZoneActions = Annotated[tuple[ZoneAction, ...], Meta(max_length=_MOST_ACTIONS)]


class Zone(Struct, frozen=True, rename="camel"):
    """An area with a rule; which fields are needed depends on its type."""

    zone_id: Name
    zone_type: Name
    vertices: tuple[Vertex, ...]
    maximum_speed: Annotated[float, Meta(gt=0)] | None = None
    release_loss_behavior: str | None = None
    entry_actions: ZoneActions | None = None
    during_actions: ZoneActions | None = None
    exit_actions: ZoneActions | None = None


class ZoneSet(Struct, frozen=True, rename="camel"):
    """The zones of one map."""

    map_id: Name
    zone_set_id: Name
    zones: Annotated[tuple[Zone, ...], Meta(max_length=MOST_ZONES)]


class ZoneSetMessage(Addressed, frozen=True, rename="camel"):
    """A zone set to keep."""

    zone_set: ZoneSet


class Response(Struct, frozen=True, rename="camel"):
    """What the fleet manager says to one request."""

    request_id: Name
    grant_type: Literal["GRANTED", "QUEUED", "REVOKED", "REJECTED"]
    lease_expiry: str | None = None


class Responses(Addressed, frozen=True, rename="camel"):
    """Answers to requests of the state."""

    responses: Annotated[tuple[Response, ...], Meta(max_length=MOST_ZONES)]
