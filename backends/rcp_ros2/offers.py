"""What clients offer on the ROS graph: servers of services and actions whose work they do."""

from __future__ import annotations

import asyncio
from typing import Any

from rcp_kernel.errors import AlreadyRunning, BadRequest, UnsupportedOperation
from rcp_kernel.spi import Progress, caller
from rcp_offers import (
    OFFER,
    RESPOND,
    TAKE,
    Answer,
    Offer,
    Offers,
    Owner,
    Take,
    Waiting,
    control_resources,
)
from rcp_ros2.idl import MissingType, load
from rcp_ros2.link import RosLink
from rcp_ros2.offer_servers import ActionServer, OfferNode, ServiceServer

__all__ = ["GraphOffers"]

_PLACE = "ros/"
_MOST, _MOST_OF_ONE, _WAITING = 256, 64, 16


class GraphOffers:
    """Offers, each with its server."""

    def __init__(self, link: RosLink) -> None:
        self._link = link
        self._offers = Offers(most=_MOST, most_of_one=_MOST_OF_ONE, waiting=_WAITING)
        self._node = OfferNode(link)
        link.ros.on_close.append(self._node.close)
        resources = control_resources(_PLACE, None, {"offers": "graph"})
        self._names = frozenset(resource.name for resource in resources)
        link.host.declare(*resources)

    def has(self, name: str) -> bool:
        """Return whether a resource belongs to them."""
        return name in self._names

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Offer something, or begin with or answer a call."""
        asked = caller()
        owner = None if asked is None else asked.principal.identity
        _, _, rest = name.partition("/")
        match rest.removeprefix(_PLACE), value:
            case (name, Offer()) if name == OFFER:
                return await self._offer(value, owner, progress)
            case (name, Take()) if name == TAKE:
                return self._offers.take(value, owner)
            case (name, Answer()) if name == RESPOND:
                return self._offers.respond(value, owner)
            case _:
                raise UnsupportedOperation(f"'{name}' cannot be executed")

    async def _offer(self, offer: Offer, owner: Owner, progress: Progress) -> None:
        """Serve until the command is cancelled, or its client has gone."""
        if not offer.type:
            raise BadRequest(
                f"{offer.name} has no type", remedy="Say which: `std_srvs/srv/SetBool`."
            )
        try:
            type_ = load(offer.type, "srv" if offer.kind == "service" else "action")
        except MissingType as error:
            raise BadRequest(str(error), remedy=error.remedy) from None

        def tell(waiting: Waiting) -> None:
            progress(waiting)

        name = "/" + offer.name.strip("/")
        with self._offers.offering(offer, owner, tell) as offered:
            if self._link.graph.has(offer.kind, name):
                raise AlreadyRunning(
                    f"a node offers the {offer.kind} {name}", remedy="Offer it by another name."
                )
            if offer.kind == "service":
                server = ServiceServer(self._link, type_, name, offered, self._node)
            else:
                server = ActionServer(self._link, type_, name, offered, self._node)
            try:
                await server.open()
                progress(Waiting())  # it can be called from now on
                await asyncio.Event().wait()
            finally:
                await offered.closed()
                server.close()
