"""The hub's sessions with one robot's gateway: its own, and one for each person who acts there."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import partial

import structlog

from rcp_client.address import Address
from rcp_client.carrier import Carrier, Lost, Received
from rcp_client.client import Client
from rcp_client.messages import Codec, Notice
from rcp_client.settings import Settings
from rcp_fleet.config import FleetConfig
from rcp_fleet.link import FleetLink, FleetLinks
from rcp_fleet.values import RobotFeed
from rcp_hubs.assertion import OWN_PROOF
from rcp_hubs.signer import HubSigner
from rcp_kernel.errors import AdapterUnavailable, Forbidden, Unauthenticated
from rcp_kernel.spi import Principal
from rcp_zenoh.statistics import LinkStatistics

__all__ = ["GatewaySessions"]

log = structlog.get_logger("rcp.fleet")
_LONGEST_PAUSE = 1.0  # s between two attempts while the gateway is alive
_OWN_ROLES = ("hub",)


class GatewaySessions:
    """All sessions with one gateway, each on a link of its own while the gateway is alive."""

    def __init__(
        self,
        config: FleetConfig,
        links: FleetLinks,
        tenant: str,
        gateway: str,
        signer: HubSigner | None,
    ) -> None:
        self._config, self._fleet, self._signer = config, links, signer
        self._tenant, self._gateway = tenant, gateway
        self._alive = asyncio.Event()
        self._links: set[FleetLink] = set()
        self.statistics = LinkStatistics({})
        """Of all links with the gateway."""
        self._persons: dict[tuple[str, str, tuple[str, ...]], _PersonSession] = {}
        """Those that take new users."""
        self.held: set[_PersonSession] = set()
        """All that are not closed."""
        self.own = self._client(
            config.token
            if signer is None
            else partial(signer.token, self._audience, config.hub, OWN_PROOF, _OWN_ROLES)
        )
        """The hub's own, for what it does for nobody in particular."""

    @property
    def _audience(self) -> str:
        return f"{self._tenant}/{self._gateway}"

    def _client(self, token: str | Callable[[], str] | None) -> Client:
        def feed_of(id_: str | None) -> RobotFeed | None:
            found = client.channel.subscriptions.get(id_ or "")
            return found if isinstance(found, RobotFeed) else None

        client = Client(
            Settings(
                address=Address.parse("fleet"),
                token=token,
                connect_timeout=self._config.connect_timeout,
                patience=None,
                longest_pause=_LONGEST_PAUSE,
                client=f"hub {self._config.hub}",
                persistent=True,
                dial=partial(self._dial, feed_of),
            )
        )
        return client

    def alive(self, *, here: bool) -> None:
        """Note that the gateway's token has appeared or gone."""
        if here:
            self._alive.set()
            return
        self._alive.clear()
        for link in list(self._links):
            link.close("the gateway is gone")

    async def _dial(
        self,
        feed_of: Callable[[str | None], RobotFeed | None],
        codec: Codec,
        received: Received,
        lost: Lost,
    ) -> Carrier:
        await self._alive.wait()

        def ended(link: Carrier) -> None:
            self._links.discard(link)  # pyright: ignore[reportArgumentType] - made below
            lost(link)

        link = self._fleet.open(self._gateway, self.statistics, feed_of, codec, received, ended)
        self._links.add(link)
        return link

    @asynccontextmanager
    async def acting(self, principal: Principal | None) -> AsyncGenerator[Client]:
        """Enter the session of a person, or the hub's own if nobody asked.

        :raises Forbidden: the hub asserts no role of the person, or not to this gateway.
        :raises AdapterUnavailable: the gateway refuses the hub.
        """
        if principal is None or self._signer is None:
            yield self.own
            return
        roles = self._roles(principal)
        key = (principal.name, principal.proof, roles)
        held = self._persons.get(key)
        if held is None:
            token = partial(
                self._signer.token, self._audience, principal.name, principal.proof, roles
            )
            gone = partial(self._persons.pop, key, None)
            held = _PersonSession(self._client(token), self._config.idle, gone, self.held.discard)
            self._persons[key] = held
            self.held.add(held)
        async with held.used() as client:
            yield client

    def _roles(self, principal: Principal) -> tuple[str, ...]:
        held = [r for t, roles in principal.grants if t in ("*", self._tenant) for r in roles]
        asserted = self._config.roles
        roles = tuple(dict.fromkeys(r for r in held if not asserted or r in asserted))
        if not roles:
            raise Forbidden(
                f"the hub asserts no role of {principal.name} to robots",
                remedy="Ask the operator of the hub: `roles` of its backend `fleet` lists them.",
            )
        return roles

    async def close(self) -> None:
        """Close all sessions; what robots do goes on as their own gateways decide."""
        persons = [held.close() for held in list(self.held)]
        await asyncio.gather(self.own.channel.close(), *persons)


class _PersonSession:
    """A session with its users; without any, it closes after a while."""

    def __init__(
        self,
        client: Client,
        idle: float,
        gone: Callable[[], object],
        closed: Callable[[_PersonSession], object],
    ) -> None:
        """`gone` is called when it takes no new users any more, `closed` when it is closed."""
        self._client, self._idle, self._gone, self._closed = client, idle, gone, closed
        self._users = 0
        self._over = False
        self._timer: asyncio.TimerHandle | None = None
        self._closing: asyncio.Task[None] | None = None
        self._opening = asyncio.create_task(client.channel.open(), name="fleet person")
        client.channel.listeners.append(self._note)

    def _note(self, notice: Notice) -> None:
        if notice.code == "refused":  # the next request begins anew, and is told why
            log.warning("fleet_person_refused", reason=notice.message)
            self._leave()

    def _leave(self) -> None:
        """Take no new users."""
        if not self._over:
            self._over = True
            self._gone()
            self._stay()
            self._rest()

    def _stay(self) -> None:
        """Do not close for want of users yet."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @asynccontextmanager
    async def used(self) -> AsyncGenerator[Client]:
        """Open the session if needed, and keep it open while entered."""
        self._users += 1
        self._stay()
        try:
            try:
                await asyncio.shield(self._opening)
            except Unauthenticated as error:
                self._leave()
                raise AdapterUnavailable(
                    f"the robot's gateway refuses this hub: {error.message}", remedy=error.remedy
                ) from error
            except Exception:
                self._leave()
                raise
            yield self._client
        finally:
            self._users -= 1
            self._rest()

    def _rest(self) -> None:
        if not self._users and self._timer is None and self._closing is None:
            wait = 0.0 if self._over else self._idle
            self._timer = asyncio.get_running_loop().call_later(wait, self._end)

    def _end(self) -> None:
        self.close()
        self._leave()

    def close(self) -> asyncio.Task[None]:
        """Close the session; return the task that does."""
        if self._closing is None:
            self._closing = asyncio.create_task(self._close(), name="fleet person")
        return self._closing

    async def _close(self) -> None:
        self._stay()
        self._opening.cancel()
        await asyncio.gather(self._opening, return_exceptions=True)
        await self._client.channel.close()
        self._closed(self)
