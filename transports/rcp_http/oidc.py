"""`/login/oidc`: where a browser begins to log in at an issuer, and comes back. All answers are for people."""

from __future__ import annotations

from contextlib import suppress
from html import escape
from typing import NamedTuple
from urllib.parse import quote, urlencode

from litestar import Controller, get
from litestar.di import NamedDependency
from litestar.params import FromPath
from litestar.types import ASGIApp

from rcp_gateway.api import to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import (
    BadRequest,
    Forbidden,
    RateLimited,
    RcpError,
    Unauthenticated,
    UnknownPath,
)
from rcp_web.application import WebRequest, response, scope_of
from rcp_web.asgi import Headers, Scope, header, peer_of, retry_after
from rcp_web.logins import LOGINS, LoginService, login_cookie, shown_login
from rcp_web.oidc import OIDC, OidcService, Parameters, Returned, Started, shown_start, start_cookie
from rcp_web.own_page import is_same_origin
from rcp_web.query import read_query, single

__all__ = ["OidcLogin"]

_MOST = 20  # parameters
_HTML = b"text/html; charset=utf-8"
_OWN = (None, b"same-origin", b"none")
_SECURE = ("https", "wss")
_HEADERS: Headers = [
    (b"cache-control", b"no-store"),
    (b"referrer-policy", b"no-referrer"),  # the address has the code
    (b"content-security-policy", b"default-src 'none'; base-uri 'none'; frame-ancestors 'none'"),
]
_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="color-scheme" content="light dark">
<meta name="viewport" content="width=device-width"><title>Log in · RCP gateway</title>
<main><h1>You are not logged in</h1><p>{message}.</p><p>{remedy}</p>
<p>{links}</p></main></html>
"""


class _Place(NamedTuple):
    """One issuer, as seen by a request."""

    oidc: OidcService
    logins: LoginService
    id: str
    origin: str
    """Of the gateway's pages."""

    @property
    def secure(self) -> bool:
        """Whether these are on TLS, whoever adds it: only the cookies of TLS count then."""
        return self.origin.startswith("https:")


class OidcLogin(Controller):
    """The login of a person at an issuer."""

    path = "/login/oidc"
    include_in_schema = False  # no calls: addresses that a browser is sent to

    @get("/{id:str}")
    async def begin(
        self,
        id: FromPath[str],  # noqa: A002 - its name in the address
        request: WebRequest,
        client_api: NamedDependency[ClientApi],
    ) -> ASGIApp:
        """Send the browser to the issuer."""
        scope = scope_of(request)
        try:
            place, given = _place(client_api, scope, id), _parameters(scope)
            if header(scope, b"sec-fetch-site") not in _OWN:
                raise Forbidden(
                    "another page has led here", remedy="To log in, choose it here yourself."
                )
            former = shown_login(scope, secure=place.secure)
            wanted = Started(given.get("next", "/"), given.get("remember") == "true", former)
            begun = await place.oidc.begin(id, wanted)
        except Exception as error:
            return _refused(client_api, scope, id, to_internal_error(error, path=scope["path"]))
        return _to(begun.location, start_cookie(place.origin, begun.sealed, begun.lifetime))

    @get("/{id:str}/callback")
    async def callback(
        self,
        id: FromPath[str],  # noqa: A002 - its name in the address
        request: WebRequest,
        client_api: NamedDependency[ClientApi],
    ) -> ASGIApp:
        """Begin a login for the person that the issuer has sent back."""
        scope = scope_of(request)
        cookies: Headers = []
        try:
            place = _place(client_api, scope, id)
            started = shown_start(scope, secure=place.secure)
            returned = place.oidc.returned(id, started, _parameters(scope))
            cookies.append(start_cookie(place.origin, "", 0))  # it was good for one answer
            cookies.append(await _log_in(client_api, scope, place, returned))
        except Exception as error:
            told = to_internal_error(error, path=scope["path"])
            return _refused(client_api, scope, id, told, cookies)
        page = quote(returned.started.next, safe="/#?&=%:@,;+!$'()*~")
        return _to(place.oidc.root(id) + page, *cookies)


async def _log_in(
    client_api: ClientApi, scope: Scope, place: _Place, returned: Returned
) -> tuple[bytes, bytes]:
    """Begin a login; return its cookie."""
    peer = peer_of(scope)
    with client_api.attempt(peer):  # each one asks the issuer
        principal = await place.oidc.finish(place.id, returned)
    remember, former = returned.started.remember, returned.started.former
    try:
        client_api.charge(client_api.session(principal, None, peer))
        made = place.logins.begin(principal, peer.address, remember=remember)
    except BaseException:
        place.oidc.release(principal.credential or "")
        raise
    if former is not None:
        place.logins.end(former)
    return login_cookie(place.origin, made.secret, made.lifetime if remember else None)


def _place(client_api: ClientApi, scope: Scope, id_: str) -> _Place:
    """Return the issuer of a request.

    :raises UnknownPath: there is none.
    :raises BadRequest: the browser does not use the gateway's configured address.
    """
    oidc, logins = client_api.service(OIDC), client_api.service(LOGINS)
    if oidc is None or logins is None:
        raise UnknownPath(
            "this gateway has no such login", remedy="Open the gateway's page and log in there."
        )
    root = oidc.root(id_)
    scheme, _, rest = root.partition("://")
    origin = f"{scheme}://{rest.partition('/')[0]}".lower()
    host = header(scope, b"host") or b""
    if not is_same_origin(origin, host, secure=scope["scheme"] in _SECURE):
        raise BadRequest(
            f"the login with {oidc.link(id_).name} is for the address {root} of this gateway",
            remedy="Open the gateway at that address and log in there.",
        )
    return _Place(oidc, logins, id_, origin)


def _parameters(scope: Scope) -> Parameters:
    query = read_query(scope["query_string"], _MOST)
    return {name: single(name, values) for name, values in query.items()}


def _to(location: str, *cookies: tuple[bytes, bytes]) -> ASGIApp:
    headers = [*_HEADERS, *cookies, (b"location", location.encode("latin-1"))]
    return response(303, b"", _HTML, headers)


def _refused(
    client_api: ClientApi, scope: Scope, id_: str, error: RcpError, cookies: Headers | None = None
) -> ASGIApp:
    """Answer with a page that says what is wrong, and where to go on."""
    client_api.refused("login", error.code)
    if isinstance(error, (Unauthenticated, Forbidden, RateLimited)):
        client_api.turned_away(peer_of(scope), error)
    links = ""
    oidc = client_api.service(OIDC)
    if oidc is not None:
        with suppress(UnknownPath):  # the configuration may have changed meanwhile
            link = oidc.link(id_)
            links = _link(f"{link.url}?{urlencode({'next': '/'})}", f"Log in with {link.name}")
            links += " · " + _link(oidc.root(id_) + "/", "Open the gateway")
    body = _PAGE.format(
        message=escape(error.message[:1].upper() + error.message[1:]),
        remedy=escape(error.remedy or ""),
        links=links,
    )
    headers = [*_HEADERS, *(cookies or []), *retry_after(error.retry_after)]
    return response(error.http, body.encode(), _HTML, headers)


def _link(url: str, text: str) -> str:
    return f'<a href="{escape(url)}">{escape(text)}</a>'
