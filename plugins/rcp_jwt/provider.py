"""What an issuer says of itself by OpenID Connect Discovery."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

import msgspec

from rcp_jwt.documents import Unreachable, fetch, read_document
from rcp_jwt.urls import is_private_url
from rcp_protocol.plain import is_list, is_map

__all__ = ["Provider", "discover"]

_DOCUMENT = "/.well-known/openid-configuration"


class Provider(msgspec.Struct, frozen=True, kw_only=True):
    """The addresses of an issuer, and how it is to be spoken to."""

    jwks: str
    authorization: str | None
    """None: people cannot log in."""
    token: str | None
    end_session: str | None
    """Where a person logs out."""
    posts_secret: bool
    """Whether the client's secret belongs into the form: the issuer does not take it in a header."""
    tells_issuer: bool
    """Whether each of its redirects says that it is of this issuer (RFC 9207)."""


async def discover(issuer: str) -> Provider:
    """Fetch and check the discovery document of an issuer.

    :raises Unreachable: it cannot be fetched, is of another issuer, or names no place for keys.
    """
    try:
        document = read_document(await fetch(issuer.rstrip("/") + _DOCUMENT))
    except ValueError:
        raise Unreachable("the discovery document is not JSON") from None
    if not is_map(document) or document.get("issuer") != issuer:
        raise Unreachable("the discovery document names another issuer")

    def url(name: str) -> str | None:
        found: Any = document.get(name)
        return found if isinstance(found, str) and _fits(found, issuer) else None

    jwks = url("jwks_uri")
    if jwks is None:
        raise Unreachable("the discovery document has no `jwks_uri` with https")
    methods: Any = document.get("token_endpoint_auth_methods_supported")
    posts = is_list(methods) and "client_secret_basic" not in methods
    return Provider(
        jwks=jwks,
        authorization=url("authorization_endpoint"),
        token=url("token_endpoint"),
        end_session=url("end_session_endpoint"),
        posts_secret=posts and "client_secret_post" in methods,
        tells_issuer=document.get("authorization_response_iss_parameter_supported") is True,
    )


def _fits(url: str, issuer: str) -> bool:
    """Return whether a URL is as well protected as its issuer's own."""
    return is_private_url(url) and urlsplit(url).scheme in ("https", urlsplit(issuer).scheme)
