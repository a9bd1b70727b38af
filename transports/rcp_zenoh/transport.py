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
from rcp_zenoh.session import Intake, configuration, on_loop, opened
from rcp_zenoh.statistics import Statistics

__all__ = ["joined"]

log = structlog.get_logger("rcp.zenoh")
_OF_ONE, _MOST = (
    256,
    1024,
)  # links of one hub, and of all: each is a session that may yet say who it is
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
    ) -> None:
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
        elif (hub, link) not in self._links and not self._client_api.closing:
            config = self._config
            keys = LinkKeys.of(config.tenant, config.gateway, hub, link)
            if not (self._has_room(hub) and self._declared.has_room(keys.down)):
                log.warning("zenoh_link_refused", hub=hub, links=len(self._links))
                return
            self._links[hub, link] = HubLink(
                self._client_api,
                self._session,
                self._declared.of(keys.down),
                encoding_of(link),
                config,
                self._allowance,
                self._statistics.of(hub),
                partial(self._links.pop, (hub, link), None),
            )

    def _has_room(self, hub: str) -> bool:
        own = sum(other == hub for other, _ in self._links)
        return own < _OF_ONE and len(self._links) < _MOST

    def message(self, sample: zenoh.Sample) -> None:
        """Pass a message to its link; without a token it is nobody's."""
        link = self._links.get((part(sample.key_expr, 4), part(sample.key_expr, 5)))
        if link is not None:
            link.received(sample)

    def close(self) -> None:
        """End all links."""
        for link in list(self._links.values()):
            link.close("the gateway is closing")


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
    loop, keys = client_api.loop, links_of(config.tenant, config.gateway)
    zenoh_config = configuration(
        "client", connect=config.connect, silence=config.silence, tls=config.tls
    )
    async with opened(zenoh_config, patient=True) as session:
        links = _Links(config, client_api, session, statistics)
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
            await asyncio.Event().wait()
        finally:
            links.close()
            for one in (own, revocations, messages, tokens):
                one.undeclare()
