"""Cookies of the gateway's own pages.

On TLS a cookie has the prefix `__Host-`: only the gateway's own answers over TLS can set it. Others, also of
neighbouring hosts and of whoever is on the way, can plant the plain one, so it counts only where the gateway
sets it: at this machine's own addresses, and not where they have TLS. Cookies are not separated by port, so the
name has the port.
"""

from __future__ import annotations

from ipaddress import ip_address
from typing import Literal, NamedTuple
from urllib.parse import urlsplit

from rcp_kernel.errors import Forbidden
from rcp_web.asgi import Scope, header

__all__ = ["CookieKind", "shown_cookie", "shows_secure"]

_SECURE = ("https", "wss")


class CookieKind(NamedTuple):
    """A cookie by its name, and the requests of other sites it goes along with."""

    name: str
    same_site: Literal["Lax", "Strict"]

    def header(self, origin: str, value: str, age: int | None) -> tuple[bytes, bytes]:
        """Return the header that has a page's browser keep a value, for `age` s or until it is closed.

        :raises Forbidden: the page was loaded over plain HTTP from another machine.
        """
        parts = urlsplit(origin)
        secure = parts.scheme == "https"
        if not secure and not _is_here(parts.hostname or ""):
            raise Forbidden(
                "a login is not kept in a cookie that would cross the network in plain text",
                remedy="Open the gateway over https, or send the token with each request.",
            )
        name = self.full_name(_port(parts.netloc.encode("latin-1")), secure=secure)
        fields = [f"{name}={value}", "Path=/", "HttpOnly", f"SameSite={self.same_site}"]
        if secure:
            fields.append("Secure")
        if age is not None:
            fields.append(f"Max-Age={age}")
        return b"set-cookie", "; ".join(fields).encode()

    def full_name(self, port: str, *, secure: bool) -> str:
        """Return the name for a port; empty: the one of the scheme."""
        return ("__Host-" if secure else "") + self.name + (f"_{port}" if port else "")


def shown_cookie(scope: Scope, kind: CookieKind, *, secure: bool) -> str | None:
    """Return the value in the cookie of a request; None if there is none, or more than one.

    `secure` means that the configuration says that browsers use this address over TLS.
    """
    found = _values(scope, kind)
    for one in (True,) if secure or not _may_be_plain(scope) else (True, False):
        if one in found:
            return found[one][0] if len(found[one]) == 1 else None
    return None


def shows_secure(scope: Scope, kind: CookieKind) -> bool:
    """Tell whether a request has the cookie that browsers send over TLS alone."""
    return True in _values(scope, kind)


def _may_be_plain(scope: Scope) -> bool:
    """Tell whether the gateway may have given the browser of a request a cookie without TLS."""
    if scope["scheme"] in _SECURE or (header(scope, b"origin") or b"").startswith(b"https:"):
        return False
    try:
        host = urlsplit("//" + (header(scope, b"host") or b"").decode("latin-1")).hostname
    except ValueError:
        return False
    return _is_here(host or "")


def _values(scope: Scope, kind: CookieKind) -> dict[bool, list[str]]:
    """Return the values in the cookies of a request, by whether the cookie is that of TLS."""
    port = _port(header(scope, b"host") or b"")
    names = {kind.full_name(port, secure=secure): secure for secure in (True, False)}
    found: dict[bool, list[str]] = {}
    for key, value in scope["headers"]:
        if key == b"cookie":
            for part in value.decode("latin-1").split(";"):
                name, _, secret = part.strip().partition("=")
                if name in names:
                    found.setdefault(names[name], []).append(secret)
    return found


def _port(host: bytes) -> str:
    port = host.rpartition(b":")[2] if not host.endswith(b"]") and b":" in host else b""
    text = port.decode("latin-1")
    return text if text.isdecimal() and text not in ("80", "443") else ""


def _is_here(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
