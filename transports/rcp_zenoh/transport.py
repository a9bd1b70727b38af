"""The gateway's end of Zenoh: its token, and one link for each hub that speaks to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Any

import structlog
import zenoh

from rcp_gateway.client_api import ClientApi
from rcp_kernel.features import ServiceKey
from rcp_zenoh.budget import Allowance, Budget
from rcp_zenoh.client import HubLink
from rcp_zenoh.config import ZenohConfig
from rcp_zenoh.declared_keys import DeclaredKeys
from rcp_zenoh.keys import LinkKeys, alive, encoding_of, links_of, part, revoked
from rcp_zenoh.pipe import refuse
from rcp_zenoh.session import Intake, configuration, on_loop, opened
from rcp_zenoh.statistics import Statistics

__all__ = ["joined"]

log = structlog.get_logger("rcp.zenoh")
_OF_ONE = 256  # links of one hub
_MOST = 1024  # links of all hubs: with so many that have said who they are, no other begins
_UNPROVED = 1024  # links that have yet to say who they are: with more, the oldest one ends
_LOG = 10.0  # s between two lines about links that are refused
_REVOCATIONS: ServiceKey[Callable[[bytes], None]] = ServiceKey("hubs.revocations")
"""As of the feature `hubs`: takes the list of revoked hubs."""


class _Links:
    """The links of all hubs, by hub and link."""

    def __init__(
        self,
        config: ZenohConfig,
        client_api: ClientApi,
        session: zenoh.Session,
        statistics: Statistics,
        spent: asyncio.Event,
    ) -> None:
        """Set `spent` when no more keys can be declared."""
        self._spent = spent
        self._refused, self._logged_at = 0, float("-inf")
        self._config, self._client_api, self._session = config, client_api, session
        self._statistics, self._declared = statistics, DeclaredKeys(session)
        limit = config.budget
        self._allowance = Allowance() if limit is None else Budget(client_api.loop, limit)
        self._links: dict[tuple[str, str], HubLink] = {}

    def token(self, sample: zenoh.Sample) -> None:
        """Open or close a link with its hub's token."""
        hub, link = part(sample.key_expr, 4), part(sample.key_expr, 5)
        if sample.kind == zenoh.SampleKind.DELETE:
            known = self._links.get((hub, link))
            if known is not None:
                known.close("the hub is gone")
        elif self._spent.is_set() or self._client_api.closing:
            return  # the next session is told of all tokens that are still there
        elif (hub, link) not in self._links:
            self._open(hub, link)

    def _open(self, hub: str, link: str) -> None:
        config = self._config
        keys = LinkKeys.of(config.tenant, config.gateway, hub, link)
        if (why := self._make_room(hub)) is not None:
            refuse(self._session, keys.down, why)
            self._log_refusal(hub, why)
            return
        self._links[hub, link] = HubLink(
            self._client_api,
            self._session,
            keys.down,
            self._declare,
            encoding_of(link),
            config,
            self._allowance,
            self._statistics.of(hub),
            partial(self._links.pop, (hub, link), None),
        )

    def _make_room(self, hub: str) -> str | None:
        """End the oldest link that has yet to say who it is; return why there is no room for one.

        Whoever reaches the router can open links, but not keep one that has said who it is away.
        """
        own = [one for (other, _), one in self._links.items() if other == hub]
        if len(own) >= _OF_ONE and not _end_oldest(own):
            return f"this hub has {_OF_ONE} links already"
        unproved = [one for one in self._links.values() if not one.known]
        if len(self._links) - len(unproved) >= _MOST:
            return f"this gateway has {_MOST} links already"
        if len(unproved) >= _UNPROVED:
            _end_oldest(unproved)
        return None

    def _log_refusal(self, hub: str, why: str) -> None:
        self._refused += 1
        moment = self._client_api.loop.time()
        if moment - self._logged_at >= _LOG:
            log.warning("zenoh_link_refused", hub=hub, reason=why, refused=self._refused)
            self._refused, self._logged_at = 0, moment

    def _declare(self, key: str) -> zenoh.KeyExpr | None:
        if self._declared.has_room(key):
            return self._declared.of(key)
        self._spent.set()
        return None

    def message(self, sample: zenoh.Sample) -> None:
        """Pass a message to its link; without a token it is nobody's."""
        link = self._links.get((part(sample.key_expr, 4), part(sample.key_expr, 5)))
        if link is not None:
            link.received(sample)

    def close(self) -> None:
        """End all links."""
        spent = self._spent.is_set()
        why = "the gateway opens its Zenoh session anew" if spent else "the gateway is closing"
        for link in list(self._links.values()):
            link.close(why)


def _end_oldest(links: list[HubLink]) -> bool:
    """End the oldest link that has yet to say who it is, if there is one."""
    oldest = next((one for one in links if not one.known), None)
    if oldest is not None:
        oldest.close("the hub did not say who it is before too many others began")
    return oldest is not None


@asynccontextmanager
async def joined(config: ZenohConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Join the fleet while entered, also if its routers come later."""
    statistics = Statistics()
    facts: dict[str, Any] = {
        "gateway": config.gateway,
        "routers": list(config.connect),
        "links": statistics.rows,
    }
    serving = client_api.loop.create_task(_serve(config, client_api, statistics), name="zenoh")
    try:
        yield facts
    finally:
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving


async def _serve(config: ZenohConfig, client_api: ClientApi, statistics: Statistics) -> None:
    while True:
        await _serve_session(config, client_api, statistics)
        log.error("zenoh_session_reopened", reason="all keys that Zenoh can number are declared")


async def _serve_session(
    config: ZenohConfig, client_api: ClientApi, statistics: Statistics
) -> None:
    """Serve until no more keys can be declared."""
    spent = asyncio.Event()
    loop, keys = client_api.loop, links_of(config.tenant, config.gateway)
    zenoh_config = configuration(
        "client", connect=config.connect, silence=config.silence, tls=config.tls
    )
    async with opened(zenoh_config, patient=True) as session:
        links = _Links(config, client_api, session, statistics, spent)
        # The token of a link comes before its messages; our own comes last, when we can answer.
        tokens = session.liveliness().declare_subscriber(
            keys.token, on_loop(loop, links.token), history=True
        )
        messages = session.declare_subscriber(keys.up, Intake(loop, links.message).callback())
        take = client_api.service(_REVOCATIONS)
        revocations = session.declare_subscriber(
            revoked(config.tenant),
            on_loop(loop, lambda sample: take and take(sample.payload.to_bytes())),
        )
        own = session.liveliness().declare_token(alive(config.tenant, config.gateway))
        try:
            await spent.wait()
        finally:
            links.close()
            for one in (own, revocations, messages, tokens):
                one.undeclare()
