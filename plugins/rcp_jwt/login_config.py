"""`[jwt.login]`: the login of people at an issuer, by the authorization code flow of OpenID Connect."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any
from urllib.parse import urlsplit

import msgspec
from msgspec import Meta

from rcp_jwt.urls import is_private_url
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import ConfigError
from rcp_protocol.plain import is_list

__all__ = ["LoginConfig", "check_logins"]

_SCOPE = re.compile(r"[\x21\x23-\x5b\x5d-\x7e]+")  # RFC 6749, 3.3
_HERE = ("localhost", "127.0.0.1", "::1")


class LoginConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The gateway as a client of an issuer."""

    id: Annotated[str, Meta(pattern="^[a-z0-9][a-z0-9-]{0,31}$")]
    """Its part of the redirect URI: `<url>/rcp/v1/login/oidc/<id>/callback`."""
    url: Annotated[str, Meta(min_length=1)]
    """Address of the gateway in browsers, with its path prefix."""
    client_id: Annotated[str, Meta(min_length=1, max_length=512)]
    client_secret: Annotated[str, Meta(min_length=1)] | None = None
    """None: a public client, which only PKCE protects."""
    name: Annotated[str, Meta(min_length=1, max_length=64)] | None = None
    """For the button; default: the issuer's host name."""
    scopes: tuple[str, ...] = ("profile",)
    """Beside `openid`."""
    lifetime: Annotated[float, Meta(ge=60, le=2_592_000)] = 28_800.0
    """Seconds that a login is good for, whatever `exp` of the ID token is."""

    @property
    def root(self) -> str:
        """The address of the gateway, without a slash at its end."""
        return self.url.rstrip("/")

    @property
    def origin(self) -> str:
        """The origin of the gateway's pages, as browsers write it."""
        parts = urlsplit(self.url.lower())
        default = {"https": ":443", "http": ":80"}[parts.scheme]
        return f"{parts.scheme}://{parts.netloc.removesuffix(default)}"

    @property
    def begins_at(self) -> str:
        """Where a browser begins to log in."""
        return f"{self.root}/rcp/v1/login/oidc/{self.id}"

    @property
    def redirect_uri(self) -> str:
        """Where the issuer sends the browser back to."""
        return f"{self.begins_at}/callback"


def check_logins(logins: Sequence[tuple[str, LoginConfig]], gateway: GatewayConfig) -> None:
    """Check the logins, each with the place of its table, against each other and the gateway.

    :raises ConfigError: one of them cannot work.
    """
    taken: dict[str, str] = {}
    for where, login in logins:
        if login.id in taken:
            raise ConfigError(f"{where}: `id` = '{login.id}' is also that of {taken[login.id]}")
        taken[login.id] = where
        if "logins" not in gateway.active_features:
            raise ConfigError(f"{where} needs the feature `logins`: remove `logins = false`")
        for scope in login.scopes:
            if not _SCOPE.fullmatch(scope):
                raise ConfigError(f"{where}: {scope!r} is not a scope: write one word each")
        _check_url(login, where)
        _check_listener(login, where, gateway.transports.get("asgi", {}))


def _check_url(login: LoginConfig, where: str) -> None:
    parts = urlsplit(login.url) if is_private_url(login.url) else None
    if parts is None or parts.query or parts.fragment:
        raise ConfigError(
            f"{where}: `url` must be the https address of the gateway in browsers (or http on "
            "loopback), such as `https://robots.example.org`"
        )


def _check_listener(login: LoginConfig, where: str, listener: dict[str, Any]) -> None:
    """Find what the listener would refuse; its own table checks the rest."""
    parts = urlsplit(login.url)
    root = str(listener.get("root_path", ""))
    if parts.path.rstrip("/") != root:
        raise ConfigError(
            f"{where}: `url` has the path '{parts.path.rstrip('/')}', but "
            f"[transports.asgi] `root_path` is '{root}'"
        )
    if parts.scheme == "http" and "tls" in listener:
        raise ConfigError(
            f"{where}: `url` must be https, as the listener has [transports.asgi.tls]"
        )
    named, host = listener.get("hosts", ()), str(listener.get("host", "127.0.0.1"))
    if not named and host not in _HERE:
        return
    known = {str(one).lower() for one in (named if is_list(named) else ())} | {*_HERE, host.lower()}
    if parts.hostname not in known:
        raise ConfigError(
            f"{where}: the host '{parts.hostname}' of `url` is not listed in "
            "[transports.asgi] `hosts`"
        )
