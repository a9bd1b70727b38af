"""From the cookie of a browser to the token of a request, for requests of the gateway's own pages."""

from __future__ import annotations

from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import Forbidden
from rcp_web.asgi import Scope, header
from rcp_web.logins import LOGINS
from rcp_web.oidc import OIDC, login_at
from rcp_web.own_page import own_origin

__all__ = ["apply_login"]

_SAFE = ("GET", "HEAD", "OPTIONS")
_OWN = (None, b"same-origin", b"none")


def apply_login(client_api: ClientApi, scope: Scope) -> None:
    """Let a request that has no token of its own act for the login in its cookie.

    A cookie of a login that has ended counts as none.

    :raises Forbidden: the request may change something, and its browser does not say that a page of
        the gateway sent it.
    """
    if header(scope, b"cookie") is None or header(scope, b"authorization") is not None:
        return
    logins = client_api.service(LOGINS)
    secret = None if logins is None else login_at(scope, client_api.service(OIDC))
    if logins is None or secret is None or logins.find(secret) is None:
        return
    site = header(scope, b"sec-fetch-site")
    if own_origin(scope) is None:
        if scope["type"] == "websocket" or scope["method"] not in _SAFE:
            if site != b"same-origin" or scope["type"] == "websocket":
                raise Forbidden(
                    "a login in a cookie is only for pages of this gateway",
                    remedy="Send `Origin` as the browser does, or `Authorization: Bearer <token>` "
                    "instead of the cookie.",
                )
        elif site not in _OWN:
            return
    scope["headers"] = [*scope["headers"], (b"authorization", b"Bearer " + secret.encode())]
