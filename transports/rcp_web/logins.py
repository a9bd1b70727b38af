"""Logins that a browser keeps in a cookie: the service behind them, and the cookie."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from rcp_gateway.api import Principal
from rcp_kernel.features import ServiceKey
from rcp_web.asgi import Scope
from rcp_web.cookies import CookieKind, shown_cookie, shows_secure

__all__ = [
    "LOGINS",
    "LoginService",
    "NewLogin",
    "login_cookie",
    "no_cookie",
    "shown_login",
    "shows_tls_cookie",
]

_COOKIE = CookieKind("rcp_login", "Strict")


class NewLogin(NamedTuple):
    """A login that has begun."""

    secret: str
    lifetime: int
    """s"""
    expires: int
    """ns since the UNIX epoch."""


class LoginService(Protocol):
    """The logins of a gateway."""

    @property
    def durable(self) -> bool:
        """Whether they outlive a restart of the gateway."""
        ...

    def begin(self, principal: Principal, address: str | None, *, remember: bool) -> NewLogin:
        """Begin a login for a principal that has just proved itself by a token.

        :raises Forbidden: it proved itself by a login.
        :raises QueueFull: there are too many logins.
        """
        ...

    def find(self, secret: str) -> Principal | None:
        """Return the principal of a login; None if it has ended, or never began."""
        ...

    def end(self, secret: str) -> None:
        """End a login, and its sessions at once."""
        ...


LOGINS: ServiceKey[LoginService] = ServiceKey("logins")


def shown_login(scope: Scope, *, secure: bool = False) -> str | None:
    """Return the secret in the cookie of a request; None if there is none, or more than one.

    `secure` means that the configuration says that browsers use this address over TLS.
    """
    return shown_cookie(scope, _COOKIE, secure=secure)


def shows_tls_cookie(scope: Scope) -> bool:
    """Tell whether a request has the cookie that browsers send over TLS alone."""
    return shows_secure(scope, _COOKIE)


def login_cookie(origin: str, secret: str, age: int | None) -> tuple[bytes, bytes]:
    """Return the header that has a page's browser keep a secret, for `age` s or until it is closed.

    :raises Forbidden: the page was loaded over plain HTTP from another machine.
    """
    return _COOKIE.header(origin, secret, age)


def no_cookie(origin: str) -> tuple[bytes, bytes]:
    """Return the header that has a page's browser forget its login."""
    return login_cookie(origin, "", 0)
