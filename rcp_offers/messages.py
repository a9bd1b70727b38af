"""What a client that offers something and the gateway tell each other."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

__all__ = ["Answer", "Kind", "Offer", "Take", "Taken", "Waiting"]

Kind = Literal["service", "action"]
_Call = Annotated[str, Meta(min_length=1, max_length=64)]
_Text = Annotated[str, Meta(max_length=2000)]


class Offer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a client offers, as long as the command with it runs."""

    name: Annotated[str, Meta(pattern=r"^/?[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$", max_length=200)]
    """Below the name under which clients offer, or on the graph: `/add_two_ints`."""
    kind: Kind = "service"
    type: Annotated[str, Meta(max_length=200)] = ""
    """Its ROS type, where it has one: `std_srvs/srv/SetBool`."""
    description: Annotated[str, Meta(max_length=500)] = ""
    """A sentence for people and models."""


class Waiting(msgspec.Struct, frozen=True, kw_only=True):
    """Feedback of an offer: the calls that wait for the client, newest state first to last."""

    calls: list[str] = []
    """Ids of calls to `take`."""
    cancelled: list[str] = []
    """Ids of calls that were taken and are to be cancelled."""


class Take(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A client begins with a call."""

    call: _Call


class Taken(msgspec.Struct, frozen=True, kw_only=True):
    """The call that a client has begun with."""

    call: str
    name: str
    input: Any = None


class Answer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a client says of a call that it has taken: feedback, or its end."""

    call: _Call
    feedback: Any = None
    """Its command goes on."""
    progress: Annotated[float, Meta(ge=0, le=1)] | None = None
    """Its command goes on."""
    output: Any = None
    """The result, with which it ends."""
    error: _Text | None = None
    """Why it has failed; `output` may say more."""
    cancelled: bool = False
    """Whether it ends because it was cancelled."""
    done: bool = True
    """False: this is feedback."""
