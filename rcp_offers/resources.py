"""The resources by which clients offer."""

from __future__ import annotations

from typing import Any

from rcp_offers.messages import Answer, Offer, Take, Taken, Waiting
from rcp_protocol.model import Resource

__all__ = ["OFFER", "RESPOND", "TAKE", "control_resources"]

OFFER, TAKE, RESPOND = "offer", "take", "respond"
_YEAR = 31_536_000.0  # s: an offer lasts as long as its client


def control_resources(place: str, robot: str | None, meta: dict[str, Any]) -> tuple[Resource, ...]:
    """Return the resources; `place` is what goes before their names, `meta` the facts of `offer`."""
    offer = Resource(
        name=f"action/{place}{OFFER}",
        description=(
            "Offers a service or action of the client to others, while the command runs; its "
            "feedback names the calls to take."
        ),
        input=Offer,
        feedback=Waiting,
        examples=({"name": "/add_two_ints", "kind": "service"},),
        policy="parallel",
        timeout=_YEAR,
        outlives=False,
        moves=False,
        robot=robot,
        meta=meta,
    )
    take = Resource(
        name=f"service/{place}{TAKE}",
        description="Begins with a call of what the client offers, and returns its input.",
        input=Take,
        output=Taken,
        robot=robot,
    )
    respond = Resource(
        name=f"service/{place}{RESPOND}",
        description="Answers a call of what the client offers: with feedback, a result, or an error.",
        input=Answer,
        robot=robot,
    )
    return offer, take, respond
