"""Logins of people at an issuer of OpenID Connect: the service behind them, and the cookie of one that is under way."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from rcp_gateway.api import Principal
from rcp_kernel.features import ServiceKey
from rcp_web.asgi import Scope, header
from rcp_web.cookies import CookieKind, shown_cookie
from rcp_web.logins import shown_login

__all__ = [
    "OIDC",
    "Begun",
    "IssuerLink",
    "OidcService",
    "Parameters",
    "Returned",
    "Started",
    "login_at",
    "shown_start",
    "start_cookie",
]

_COOKIE = CookieKind("rcp_oidc", "Lax")
"""`Lax`, because the issuer's page sends the browser back: with `Strict` the cookie would not come along. It only
tells which login the browser itself began; the login's own cookie stays `Strict`."""

Parameters = dict[str, str]


class IssuerLink(NamedTuple):
    """An issuer at which people log in or out."""

    name: str
    url: str


class Started(NamedTuple):
    """What a browser wants of a login."""

    next: str
    """The page to show afterwards, from the root of the gateway: `/…`."""
    remember: bool
    """Whether the browser keeps the login when it is closed."""
    former: str | None
    """The secret of the login that it replaces."""


class Begun(NamedTuple):
    """A login that has begun: where the browser goes, and what it keeps meanwhile."""

    location: str
    sealed: str
    lifetime: int
    """s"""


class Returned(NamedTuple):
    """A browser that has come back from the issuer, with what it began with."""

    started: Started
    state: str
    nonce: str
    verifier: str
    code: str


class OidcService(Protocol):
    """The issuers at which people log in; `id` names one of them.

    Errors are for people: message and remedy are shown on a page.
    """

    @property
    def issuers(self) -> list[IssuerLink]:
        """Where people log in."""
        ...

    def link(self, id_: str) -> IssuerLink:
        """Return where people log in at one issuer.

        :raises UnknownPath: there is none.
        """
        ...

    def root(self, id_: str) -> str:
        """Return the address of the gateway in browsers, without a slash at its end."""
        ...

    def is_on_tls(self, host: bytes) -> bool:
        """Return whether `host` is the address of the gateway in browsers, over TLS."""
        ...

    async def begin(self, id_: str, started: Started) -> Begun:
        """Begin a login.

        :raises AdapterUnavailable: the issuer does not answer.
        """
        ...

    def returned(self, id_: str, sealed: str | None, given: Parameters) -> Returned:
        """Check that a browser comes back from a login that it began itself.

        :raises Forbidden: it does not, or the issuer refused the login.
        """
        ...

    async def finish(self, id_: str, returned: Returned) -> Principal:
        """Return who has logged in; each login under way counts once.

        :raises Unauthenticated: the issuer's answer does not prove it.
        :raises Forbidden: they have no role on this gateway.
        :raises AdapterUnavailable: the issuer does not answer, or not as it should.
        """
        ...

    def release(self, credential: str) -> None:
        """Forget what a person has logged in with: the login has ended, or did not begin."""
        ...

    def log_out(self, principal: Principal) -> IssuerLink | None:
        """Return where a person logs out of the issuer too, if it has such a place."""
        ...


OIDC: ServiceKey[OidcService] = ServiceKey("oidc")


def start_cookie(origin: str, sealed: str, age: int) -> tuple[bytes, bytes]:
    """Return the header that has a browser keep a login that is under way for `age` s."""
    return _COOKIE.header(origin, sealed, age)


def shown_start(scope: Scope, *, secure: bool) -> str | None:
    """Return the login under way in the cookie of a request; `secure`: the gateway's pages are on TLS."""
    return shown_cookie(scope, _COOKIE, secure=secure)


def login_at(scope: Scope, oidc: OidcService | None) -> str | None:
    """Return the secret of the login in the cookie of a request.

    At an address that people use over TLS, by the configuration, only the cookie of TLS counts.
    """
    host = header(scope, b"host") or b""
    return shown_login(scope, secure=oidc is not None and oidc.is_on_tls(host))
