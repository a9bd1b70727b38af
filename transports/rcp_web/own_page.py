"""Whether a request comes from a page of the gateway itself."""

from __future__ import annotations

from rcp_web.asgi import Scope, header
from rcp_web.logins import shows_tls_cookie

__all__ = ["is_same_origin", "own_origin"]

_DEFAULT_PORTS = {"http": ":80", "https": ":443"}
_SECURE = ("https", "wss")


def is_same_origin(origin: str, host: bytes, *, secure: bool) -> bool:
    """Return whether an origin (in lower case) is the gateway's own: a proxy may have added TLS."""
    scheme, _, netloc = origin.partition("://")
    port = _DEFAULT_PORTS.get(scheme)
    if port is None or (secure and scheme != "https"):
        return False
    return netloc.removesuffix(port) == host.decode("latin-1").lower().removesuffix(port)


def own_origin(scope: Scope) -> str | None:
    """Return the origin of a request by a page of the gateway; None if the browser does not say so.

    Behind a proxy that adds TLS, a request with the cookie of a page on TLS came over TLS.
    """
    origin, host = header(scope, b"origin"), header(scope, b"host")
    if origin is None or host is None:
        return None
    if header(scope, b"sec-fetch-site") not in (None, b"same-origin"):
        return None
    text = origin.decode("latin-1").lower()
    secure = scope["scheme"] in _SECURE or shows_tls_cookie(scope)
    return text if is_same_origin(text, host, secure=secure) else None
