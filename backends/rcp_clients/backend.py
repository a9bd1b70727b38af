"""A backend without a robot: its services and actions are carried out by the clients that offer them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

from rcp_clients.config import ClientsConfig
from rcp_clients.types import input_of, output_of
from rcp_kernel.errors import PreconditionFailed, UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_kernel.spi import BaseBackend, Host, Progress, caller
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

__all__ = ["ClientsBackend", "open_clients"]

_UNDER = "clients"
_META = {"offers": "tree"}


class ClientsBackend(BaseBackend):
    """Offers, and the calls of what is offered."""

    def __init__(self, config: ClientsConfig, host: Host) -> None:
        self._config = config
        self._host = host
        self._offers = Offers(
            most=config.offers, most_of_one=config.offers_of_one, waiting=config.waiting
        )
        # A name of its own, below which nobody can pass for a robot.
        self._robot = None if host.robot else _UNDER
        self._place = "" if host.robot else f"{_UNDER}/"
        self._declared: set[str] = set()

    def begin(self) -> None:
        """Declare the resources by which clients offer."""
        self._declare(*control_resources(self._place, self._robot, _META))

    def _declare(self, *resources: Resource) -> None:
        self._host.declare(*resources)
        self._declared.update(resource.name for resource in resources)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Offer something, begin with or answer a call, or call what is offered."""
        asked = caller()
        owner = None if asked is None else asked.principal.identity
        kind, _, rest = name.partition("/")
        rest = rest.removeprefix(self._place)
        if (kind, rest) == ("action", OFFER):
            return await self._offer(value, owner, progress)
        if (kind, rest) == ("service", TAKE):
            return self._offers.take(_of(Take, value), owner)
        if (kind, rest) == ("service", RESPOND):
            return self._offers.respond(_of(Answer, value), owner)
        offered = self._offers.find(kind, rest)
        if offered is None:
            raise UnsupportedOperation(f"'{name}' is not offered")
        return await offered.call(value, progress)

    async def _offer(self, offer: Offer, owner: Owner, progress: Progress) -> None:
        """Offer something until the command is cancelled, or its client has gone."""
        resource = self._resource(offer, "" if owner is None else owner[0])

        def tell(waiting: Waiting) -> None:
            progress(waiting)

        with self._offers.offering(offer, owner, tell) as offered:
            if resource.name in self._declared:
                raise PreconditionFailed(
                    f"{offer.name} exists already", remedy="Offer it by another name."
                )
            self._declare(resource)
            progress(Waiting())  # it can be called from now on
            try:
                await asyncio.Event().wait()
            finally:
                await offered.closed()  # before calls end because the resource is gone
                self._declared.discard(resource.name)
                self._host.withdraw(resource.name)

    def _resource(self, offer: Offer, by: str) -> Resource:
        service = offer.kind == "service"
        meta = {"offered": {"name": "/" + offer.name.strip("/"), "type": offer.type, "by": by}}
        description = offer.description.strip() or f"{offer.name}, offered by the client {by}."
        return Resource(
            name=f"{offer.kind}/{self._place}{offer.name.strip('/')}",
            description=description if description.endswith(".") else description + ".",
            input=input_of(offer.type),
            output=output_of(offer.type),
            feedback=None if service else Any,
            policy="parallel",
            timeout=self._config.service_timeout if service else self._config.action_timeout,
            moves=False,  # what a client moves for it, it moves through the gateway
            robot=self._robot,
            meta=meta,
        )


def _of(type_: type[Any], value: Any) -> Any:
    assert isinstance(value, type_)
    return value


@asynccontextmanager
async def open_clients(config: ClientsConfig, host: Host) -> AsyncGenerator[ClientsBackend]:
    """Let clients offer while entered."""
    backend = ClientsBackend(config, host)
    backend.begin()
    yield backend
