"""Which web pages may use the gateway, and under which host names.

A browser sends `Origin` with requests of a script or form of another site, and `Sec-Fetch-Site`
with what such a page embeds; DNS rebinding to loopback is detected by `Host`.
"""

from __future__ import annotations

from collections.abc import Iterable
from ipaddress import ip_address
from urllib.parse import urlsplit

from rcp_kernel.errors import Forbidden
from rcp_web.asgi import Scope
from rcp_web.own_page import is_same_origin

__all__ = ["Origins", "is_loopback"]

_LOOKED_AT = frozenset(
    (b"host", b"origin", b"sec-fetch-site", b"sec-fetch-mode", b"sec-fetch-dest")
)
_SECURE = ("https", "wss")


def is_loopback(host: str) -> bool:
    """Return whether a listening address is reachable from this machine only."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class Origins:
    """The rules, built from the configuration once."""

    def __init__(self, host: str, origins: Iterable[str], hosts: Iterable[str]) -> None:
        self._origins = frozenset(origin.rstrip("/").lower() for origin in origins)
        named = [name.lower() for name in hosts]
        self._hosts: frozenset[str] | None = None
        if named or is_loopback(host):
            self._hosts = frozenset((*named, host.lower(), "localhost", "127.0.0.1", "::1"))
        self._known: dict[bytes, bool] = {}

    def check(self, scope: Scope) -> str | None:
        """Return the foreign but allowed origin of a request, None if there is none.

        :raises Forbidden: the origin or the host name is not allowed.
        """
        found: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:
            if name in _LOOKED_AT:
                if name in found:
                    raise Forbidden(f"the header {name.decode()} occurs twice")
                found[name] = value
        host = found.get(b"host")
        if host is not None and not self._is_ours(host):
            raise Forbidden(
                f"host {host.decode('latin-1')[:80]!r} is not listed in `hosts`",
                remedy="Use an address that the gateway listens on, or add the name to "
                "`[transports.asgi] hosts`.",
            )
        origin = found.get(b"origin")
        if origin is None:
            if b"sec-fetch-site" in found:
                self._check_embedding(found, scope["method"])
            return None
        text = origin.decode("latin-1").lower()
        if host is not None and is_same_origin(text, host, secure=scope["scheme"] in _SECURE):
            return None
        if text in self._origins or "*" in self._origins:
            return text
        raise Forbidden(
            f"origin {text[:80]!r} is not listed in `origins`",
            remedy="Add the origin to `[transports.asgi] origins`.",
        )

    def _check_embedding(self, found: dict[bytes, bytes], method: str) -> None:
        """Refuse what a page of another origin embeds (images, scripts, frames): it has no Origin.

        :raises Forbidden: another origin embeds it.
        """
        if found[b"sec-fetch-site"] in (b"same-origin", b"none") or "*" in self._origins:
            return
        visit = found.get(b"sec-fetch-mode") == b"navigate" and method in ("GET", "HEAD")
        if not (visit and found.get(b"sec-fetch-dest") == b"document"):
            raise Forbidden(
                "pages of other origins cannot embed this gateway",
                remedy="Add its origin to `[transports.asgi] origins` and load it with CORS "
                "(`crossorigin`).",
            )

    def _is_ours(self, host: bytes) -> bool:
        if self._hosts is None:
            return True
        known = self._known.get(host)
        if known is None:
            known = _name(host) in self._hosts
            if len(self._known) < 1000:
                self._known[host] = known
        return known


def _name(host: bytes) -> str:
    try:
        return urlsplit("//" + host.decode("latin-1")).hostname or ""
    except ValueError:  # brackets around something other than an address
        return ""
