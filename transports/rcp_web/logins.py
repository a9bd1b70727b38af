"""Logins that a browser keeps in a cookie: the service behind them, and the cookie.

On TLS the cookie has the prefix `__Host-`: only the gateway's own answers over TLS can set it. Cookies are not
separated by port, so the name has the port.
"""

from __future__ import annotations

from ipaddress import ip_address
from typing import NamedTuple, Protocol
from urllib.parse import urlsplit

from rcp_kernel.api import Principal
from rcp_kernel.errors import Forbidden
from rcp_kernel.features import ServiceKey
from rcp_web.asgi import Scope, header

__all__ = [
    "LOGINS",
    "LoginService",
    "NewLogin",
    "login_cookie",
    "no_cookie",
    "shown_login",
    "shows_tls_cookie",
]

_NAME = "rcp_login"
_SECURE = ("https", "wss")


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


def shown_login(scope: Scope) -> str | None:
    """Return the secret in the cookie of a request; None if there is none, or more than one."""
    secure = scope["scheme"] in _SECURE
    found = _cookies(scope)
    for one in (True,) if secure else (True, False):
        if one in found:
            return found[one][0] if len(found[one]) == 1 else None
    return None


def shows_tls_cookie(scope: Scope) -> bool:
    """Tell whether a request has the cookie that browsers send over TLS alone."""
    return True in _cookies(scope)


def _cookies(scope: Scope) -> dict[bool, list[str]]:
    """Return the secrets in the cookies of a request, by whether the cookie is that of TLS."""
    port = _port(header(scope, b"host") or b"")
    names = {_name(port, secure=secure): secure for secure in (True, False)}
    found: dict[bool, list[str]] = {}
    for key, value in scope["headers"]:
        if key == b"cookie":
            for part in value.decode("latin-1").split(";"):
                name, _, secret = part.strip().partition("=")
                if name in names:
                    found.setdefault(names[name], []).append(secret)
    return found


def login_cookie(origin: str, secret: str, age: int | None) -> tuple[bytes, bytes]:
    """Return the header that has a page's browser keep a secret, for `age` s or until it is closed.

    :raises Forbidden: the page was loaded over plain HTTP from another machine.
    """
    parts = urlsplit(origin)
    secure = parts.scheme == "https"
    if not secure and not _is_here(parts.hostname or ""):
        raise Forbidden(
            "a login is not kept in a cookie that would cross the network in plain text",
            remedy="Open the gateway over https, or send the token with each request.",
        )
    name = _name(_port(parts.netloc.encode("latin-1")), secure=secure)
    fields = [f"{name}={secret}", "Path=/", "HttpOnly", "SameSite=Strict"]
    if secure:
        fields.append("Secure")
    if age is not None:
        fields.append(f"Max-Age={age}")
    return b"set-cookie", "; ".join(fields).encode()


def no_cookie(origin: str) -> tuple[bytes, bytes]:
    """Return the header that has a page's browser forget its login."""
    return login_cookie(origin, "", 0)


def _name(port: str, *, secure: bool) -> str:
    return ("__Host-" if secure else "") + _NAME + (f"_{port}" if port else "")


def _port(host: bytes) -> str:
    port = host.rpartition(b":")[2] if not host.endswith(b"]") and b":" in host else b""
    text = port.decode("latin-1")
    return text if text.isdecimal() and text not in ("80", "443") else ""


def _is_here(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
