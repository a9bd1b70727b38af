"""`/login`: begin and end the login that a browser keeps in a cookie."""

from __future__ import annotations

from typing import Any

import msgspec
from litestar import Controller, delete, get, post
from litestar.di import NamedDependency
from litestar.types import ASGIApp

from rcp_gateway.api import Principal
from rcp_gateway.client_api import ClientApi
from rcp_http.openapi_calls import TEXT
from rcp_http.openapi_responses import refusals
from rcp_kernel.clock import iso
from rcp_kernel.errors import BadRequest, Forbidden, UnknownPath
from rcp_web.application import WebRequest, response, scope_of
from rcp_web.asgi import Headers, Scope, peer_of, read_body
from rcp_web.calls import call as declared
from rcp_web.logins import LOGINS, LoginService, login_cookie, no_cookie
from rcp_web.oidc import OIDC, login_at
from rcp_web.own_page import own_origin

__all__ = ["Login"]

_LONGEST = 32_768  # bytes of a body: a token has at most 16,384 characters
_NO_STORE: Headers = [(b"cache-control", b"no-store")]
_LINK: dict[str, Any] = {
    "type": "object",
    "required": ["name", "url"],
    "properties": {"name": TEXT, "url": TEXT},
}
_STATE: dict[str, Any] = {
    "type": "object",
    "required": ["principal", "expires", "durable", "issuers", "log_out_at"],
    "properties": {
        "principal": {"type": ["string", "null"], "description": "Whose login the cookie is."},
        "expires": {"type": ["string", "null"], "description": "When it ends at the latest."},
        "durable": {
            "type": "boolean",
            "description": "Whether logins outlive a restart of the gateway.",
        },
        "issuers": {
            "type": "array",
            "items": _LINK,
            "description": "Where people log in by OpenID Connect: addresses for a browser.",
        },
        "log_out_at": {
            "anyOf": [_LINK, {"type": "null"}],
            "description": "Where the person of the cookie logs out of the issuer too.",
        },
    },
}
_WANTED: dict[str, Any] = {
    "type": "object",
    "required": ["token"],
    "properties": {
        "token": TEXT,
        "remember": {
            "type": "boolean",
            "description": "Whether the browser keeps the login when it is closed.",
        },
    },
    "additionalProperties": False,
}


class _Wanted(msgspec.Struct, forbid_unknown_fields=True):
    token: str
    remember: bool = False


def _answers(*statuses: int) -> dict[str, Any]:
    content = {"application/json": {"schema": _STATE}}
    return {"200": {"description": "The login.", "content": content}} | refusals(statuses)


class Login(Controller):
    """The login of a browser."""

    path = "/login"
    tags = ("gateway",)

    @get(
        **declared("Tell whose login the cookie is.", responses=_answers(400, 404)),
        sync_to_thread=False,
    )
    def state(self, request: WebRequest, client_api: NamedDependency[ClientApi]) -> ASGIApp:
        """Answer with the principal of the cookie, if there is one."""
        logins = _service(client_api)
        secret = login_at(scope_of(request), client_api.service(OIDC))
        return _state(client_api, logins, None if secret is None else logins.find(secret))

    @post(
        **declared(
            "Begin a login that the browser keeps in a cookie.",
            responses=_answers(400, 401, 403, 404, 413, 429, 503),
            body={"required": True, "content": {"application/json": {"schema": _WANTED}}},
        ),
        status_code=200,
    )
    async def begin(self, request: WebRequest, client_api: NamedDependency[ClientApi]) -> ASGIApp:
        """Begin a login for the principal of a token, in place of the one in the cookie."""
        scope, logins = scope_of(request), _service(client_api)
        origin = _page(scope)
        login_cookie(origin, "", 0)  # refuses a page that is not to have one
        wanted = _read(await read_body(request.receive, _LONGEST, None))
        peer = peer_of(scope)
        principal = await client_api.identify(wanted.token, peer)
        client_api.charge(client_api.session(principal, None, peer))
        made = logins.begin(principal, peer.address, remember=wanted.remember)
        former = login_at(scope, client_api.service(OIDC))
        if former is not None:
            logins.end(former)
        cookie = login_cookie(origin, made.secret, made.lifetime if wanted.remember else None)
        return _state(client_api, logins, logins.find(made.secret), cookie)

    @delete(
        **declared("End the login in the cookie.", responses=_answers(400, 403, 404)),
        status_code=200,
        sync_to_thread=False,
    )
    def end(self, request: WebRequest, client_api: NamedDependency[ClientApi]) -> ASGIApp:
        """End the login, here and in the browser."""
        scope, logins = scope_of(request), _service(client_api)
        origin = _page(scope)
        secret = login_at(scope, client_api.service(OIDC))
        ended = None if secret is None else logins.find(secret)
        if secret is not None:
            logins.end(secret)
        return _state(client_api, logins, None, no_cookie(origin), ended=ended)


def _service(client_api: ClientApi) -> LoginService:
    found = client_api.service(LOGINS)
    if found is None:
        raise UnknownPath(
            "this gateway keeps no logins",
            remedy="Send the token with each request, or have the feature `logins` turned on.",
        )
    return found


def _page(scope: Scope) -> str:
    """Return the origin of the page that asks: another one must not log its visitors in or out.

    :raises Forbidden: it is not a page of this gateway.
    """
    origin = own_origin(scope)
    if origin is None:
        raise Forbidden(
            "only pages of this gateway can log in with a cookie",
            remedy="Send `Authorization: Bearer <token>` with each request instead.",
        )
    return origin


def _read(data: bytes) -> _Wanted:
    try:
        return msgspec.json.decode(data, type=_Wanted)
    except (msgspec.DecodeError, UnicodeDecodeError):  # whose text may repeat the token
        raise BadRequest(
            "the body is not a login", remedy='Send `{"token": "...", "remember": false}` as JSON.'
        ) from None


def _state(
    client_api: ClientApi,
    logins: LoginService,
    principal: Principal | None,
    *cookies: tuple[bytes, bytes],
    ended: Principal | None = None,
) -> ASGIApp:
    expires = None if principal is None else principal.expires
    oidc, person = client_api.service(OIDC), principal or ended
    place = None if oidc is None or person is None else oidc.log_out(person)
    body = {
        "principal": None if principal is None else principal.name,
        "expires": None if expires is None else iso(expires),
        "durable": logins.durable,
        "issuers": [] if oidc is None else [one._asdict() for one in oidc.issuers],
        "log_out_at": None if place is None else place._asdict(),
    }
    return response(200, msgspec.json.encode(body), headers=[*_NO_STORE, *cookies])
