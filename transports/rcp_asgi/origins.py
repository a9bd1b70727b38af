"""Which web pages may talk to the gateway, and by which names it is called.

A browser sends `Origin` with whatever a page of another site starts; a page that rebinds its own
name to loopback is found out by `Host`.
"""

from __future__ import annotations

from collections.abc import Iterable
from ipaddress import ip_address
from urllib.parse import urlsplit

from rcp_kernel.asgi import Scope
from rcp_kernel.errors import Forbidden

__all__ = ["Origins", "is_loopback"]

_SAFE = frozenset(("GET", "HEAD", "OPTIONS"))
_DEFAULT_PORTS = (":80", ":443")


def is_loopback(host: str) -> bool:
    """Tell whether an address to listen on is reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class Origins:
    """The rules, made of the configuration once."""

    def __init__(self, host: str, origins: Iterable[str], hosts: Iterable[str]) -> None:
        self._origins = frozenset(origin.rstrip("/").lower() for origin in origins)
        named = [name.lower() for name in hosts]
        self._hosts: frozenset[str] | None = None
        if named or is_loopback(host):
            self._hosts = frozenset((*named, host.lower(), "localhost", "127.0.0.1", "::1"))
        self._known: dict[bytes, bool] = {}

    def check(self, scope: Scope) -> str | None:
        """Return the foreign but welcome origin of a request, None where there is none.

        :raises Forbidden: the page or the name is not one of those that the configuration allows.
        """
        host = origin = None
        for name, value in scope["headers"]:
            if name == b"host":
                host = value
            elif name == b"origin":
                origin = value
        if host is not None and not self._is_ours(host):
            raise Forbidden(
                f"this gateway is not called {host.decode('latin-1')[:80]!r}",
                remedy="Use an address that it listens on, or list the name in "
                "`[transports.asgi] hosts`.",
            )
        if origin is None:
            return None
        text = origin.decode("latin-1").lower()
        if host is not None and _netloc(text) == _plain(host.decode("latin-1").lower()):
            return None
        if text in self._origins or "*" in self._origins:
            return text
        if scope["type"] == "websocket" or scope["method"] not in _SAFE:
            raise Forbidden(
                f"pages of {text[:80]!r} may not use this gateway",
                remedy="List the origin in `[transports.asgi] origins`.",
            )
        return None

    def _is_ours(self, host: bytes) -> bool:
        if self._hosts is None:
            return True
        known = self._known.get(host)
        if known is None:
            name = urlsplit("//" + host.decode("latin-1")).hostname or ""
            known = name in self._hosts
            if len(self._known) < 1000:
                self._known[host] = known
        return known


def _netloc(origin: str) -> str:
    return _plain(origin.partition("://")[2])


def _plain(netloc: str) -> str:
    for port in _DEFAULT_PORTS:
        netloc = netloc.removesuffix(port)
    return netloc
