"""Agent cards: the skills available to a caller, the URLs, and the authentication schemes."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Generator
from functools import partial
from typing import Any

import msgspec
from a2a.server.context import ServerCallContext
from a2a.server.request_handlers.response_helpers import agent_card_to_dict
from a2a.types.a2a_pb2 import (
    AgentCapabilities,
    AgentCard,
    AgentInterface,
    AgentProvider,
    HTTPAuthSecurityScheme,
    MutualTlsSecurityScheme,
    OpenIdConnectSecurityScheme,
    SecurityRequirement,
    SecurityScheme,
    StringList,
)
from google.protobuf.json_format import MessageToDict

from rcp_a2a.callers import caller_of
from rcp_a2a.config import A2aConfig
from rcp_a2a.places import JWKS, PREFIX, Place
from rcp_a2a.refusals import NOT_FOUND, NOT_TAKEN, refuse
from rcp_a2a.signing import CardKey
from rcp_a2a.skills import skills_of
from rcp_gateway.api import Session, SharedWork, at_once, gateway_version
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import Forbidden, Unauthenticated
from rcp_web.asgi import JSON, Headers, Scope, Send, header, respond
from rcp_web.untrusted import TextMarker

__all__ = ["INPUT_MODES", "OUTPUT_MODES", "Cards"]

INPUT_MODES = ("application/json", "text/plain")
OUTPUT_MODES = ("application/json", "text/plain", "image/png", "image/jpeg")
_KEPT = 64  # number of cached cards
_STEP = 16  # skills that are written at once: a millisecond
_HOST = re.compile(r"[A-Za-z0-9.\-_\[\]:]+\Z")
_DESCRIPTION = (
    "Robots behind one gateway. Send a plan or a single command. The gateway checks all of it "
    "before anything moves, then runs it as a task that you can follow and cancel."
)


class Cards:
    """Builds cards, and serves the public ones."""

    def __init__(self, config: A2aConfig, client_api: ClientApi) -> None:
        """Read the signing key, if there is one.

        :raises ConfigError: it cannot be read.
        """
        self._config = config
        self._client_api = client_api
        self._key = None if config.card_key is None else CardKey(config.card_key)
        self._marker = TextMarker()
        self.grpc_port: int | None = None
        """Port of the gRPC binding, once it listens."""
        self._ready: dict[tuple[Any, ...], tuple[bytes, bytes]] = {}
        self._under_way = SharedWork[None](client_api.loop)

    def base(self, scope: Scope) -> str:
        """Return the gateway's URL as a client sees it, without a trailing slash."""
        if self._config.url is not None:
            return self._config.url.rstrip("/")
        host = (header(scope, b"host") or b"").decode("latin-1")
        if not _HOST.match(host):
            host = "localhost"
        return f"{scope['scheme']}://{host}{scope.get('root_path', '')}"

    # -- serving -------------------------------------------------------------------------------

    async def serve(self, scope: Scope, send: Send, place: Place) -> None:
        """Serve a public card, or the keys that verify it."""
        if scope["method"] not in ("GET", "HEAD"):
            await refuse(send, NOT_TAKEN, "rest")
            return
        if place.rest == JWKS:
            if self._key is None:
                await refuse(send, NOT_FOUND, "rest")
                return
            body = msgspec.json.encode(self._key.jwks)
            tag = hashlib.sha256(body).hexdigest()[:32].encode()
        else:
            body, tag = await self._public(self.base(scope), place.tenant)
        headers: Headers = [
            (b"etag", b'W/"' + tag + b'"'),
            (b"cache-control", b"public, max-age=%d" % self._config.card_max_age),
            (b"vary", b"host"),
        ]
        known = header(scope, b"if-none-match") or b""
        if known.strip() == b"*" or tag in known:
            await respond(send, 304, b"", headers=headers)
            return
        await respond(send, 200, body, JSON, headers)

    async def _public(self, base: str, tenant: str | None) -> tuple[bytes, bytes]:
        session = self._stranger(tenant)
        generation = None if session is None else self._client_api.generation(session)
        rights = None if session is None else session.rights
        key = (base, tenant, generation, rights, self._client_api.proofs)
        while (ready := self._ready.get(key)) is None:
            owner = None if session is None else session.principal.identity
            work = self._prepare(key, base, session, tenant)
            await self._under_way.result(key, partial(self._client_api.turns.finish, owner, work))
        return ready

    def _prepare(
        self, key: tuple[Any, ...], base: str, session: Session | None, tenant: str | None
    ) -> Generator[None]:
        """Build and write a public card in steps."""
        card = yield from self._make(base, session, tenant)
        # The tag covers the unsigned content: some algorithms sign differently every time.
        tag = hashlib.sha256(card.SerializeToString(deterministic=True)).hexdigest()[:32]
        written = yield from self._written(card, base)
        if len(self._ready) >= _KEPT:
            self._ready.pop(next(iter(self._ready)))
        self._ready[key] = msgspec.json.encode(written), tag.encode()

    def _stranger(self, tenant: str | None) -> Session | None:
        """Return the rights without authentication; none in a tenant that is not open to them."""
        if not self._client_api.proofs.anonymous:
            return None
        try:
            return self._client_api.session(self._client_api.authenticate(None), tenant)
        except (Unauthenticated, Forbidden):
            return None

    def _written(self, card: AgentCard, base: str) -> Generator[None, None, dict[str, Any]]:
        """Write a card as plain data in steps, signed; fields of 0.3 are added only to one that is not.

        A verifier that checks the whole document would find those fields unsigned.
        """
        if self._key is not None:
            self._key.sign(card, f"{base}{PREFIX}{JWKS}")
        compatible = self._config.old_card and self._key is None
        plain = agent_card_to_dict if compatible else MessageToDict
        part = AgentCard()
        part.CopyFrom(card)
        del part.skills[_STEP:]
        written = plain(part)
        for begin in range(_STEP, len(card.skills), _STEP):
            yield
            del part.skills[:]
            part.skills.extend(card.skills[begin : begin + _STEP])
            written["skills"] += plain(part)["skills"]
        return written

    # -- building ------------------------------------------------------------------------------

    def plain(self) -> AgentCard:
        """Build the card that the SDK uses to check requests; it is not served."""
        return at_once(self._make("http://localhost", None, None))

    async def extended(self, _card: AgentCard, context: ServerCallContext) -> AgentCard:
        """Build the card with what a caller may do."""
        caller = caller_of(context)
        work = self._make(caller.base, caller.session, caller.tenant)
        card = await self._client_api.turns.finish(caller.principal.identity, work)
        if self._key is not None:
            self._key.sign(card, f"{caller.base}{PREFIX}{JWKS}")
        return card

    def _make(
        self, base: str, session: Session | None, tenant: str | None
    ) -> Generator[None, None, AgentCard]:
        """Build a card in steps."""
        skills = yield from skills_of(self._client_api, session, self._marker)
        config = self._config
        name = config.name or self._client_api.title
        card = AgentCard(
            name=name if tenant is None else f"{name} ({tenant})",
            description=config.description or _DESCRIPTION,
            supported_interfaces=self._interfaces(base, tenant),
            version=gateway_version(),
            documentation_url=config.documentation,
            capabilities=AgentCapabilities(
                streaming=True,
                push_notifications=config.push.enabled,
                extended_agent_card=True,
            ),
            default_input_modes=INPUT_MODES,
            default_output_modes=OUTPUT_MODES,
            skills=skills,
        )
        if config.provider is not None:
            given = config.provider
            card.provider.CopyFrom(AgentProvider(organization=given.organization, url=given.url))
        self._secure(card)
        return card

    def _interfaces(self, base: str, tenant: str | None) -> list[AgentInterface]:
        url = base + PREFIX
        made = [
            AgentInterface(url=url, protocol_binding=binding, protocol_version="1.0", tenant=tenant)
            for binding in ("JSONRPC", "HTTP+JSON")
        ]
        if (grpc := self._config.grpc) is not None:
            made.append(
                AgentInterface(
                    url=grpc.url or f"{grpc.host}:{self.grpc_port or grpc.port}",
                    protocol_binding="GRPC",
                    protocol_version="1.0",
                    tenant=tenant,
                )
            )
        if self._config.compatible:
            old = url if tenant is None else f"{url}/{tenant}"
            made += [
                AgentInterface(url=old, protocol_binding=binding, protocol_version="0.3")
                for binding in ("JSONRPC", "HTTP+JSON")
            ]
        return made

    def _secure(self, card: AgentCard) -> None:
        proofs = self._client_api.proofs
        schemes: dict[str, SecurityScheme] = {}
        if proofs.bearer:
            schemes["bearer"] = SecurityScheme(
                http_auth_security_scheme=HTTPAuthSecurityScheme(
                    scheme="Bearer", description="An API key or a JSON Web Token."
                )
            )
        for number, issuer in enumerate(proofs.issuers):
            where = f"{issuer.rstrip('/')}/.well-known/openid-configuration"
            schemes["oidc" if not number else f"oidc{number + 1}"] = SecurityScheme(
                open_id_connect_security_scheme=OpenIdConnectSecurityScheme(
                    open_id_connect_url=where
                )
            )
        if proofs.certificates:
            schemes["certificate"] = SecurityScheme(
                mtls_security_scheme=MutualTlsSecurityScheme(description="A client certificate.")
            )
        for name, scheme in schemes.items():
            card.security_schemes[name].CopyFrom(scheme)
            card.security_requirements.append(SecurityRequirement(schemes={name: StringList()}))
        if proofs.anonymous and schemes:
            card.security_requirements.append(SecurityRequirement())  # or anonymous access
