"""URLs of issuers."""

from __future__ import annotations

from ipaddress import ip_address
from urllib.parse import urlsplit

__all__ = ["host_of", "is_private_url", "shown_url"]


def is_private_url(url: str) -> bool:
    """Return whether a URL is protected against eavesdropping and tampering.

    It must be `https`, or `http` on loopback, without a user name or password.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        return False
    if host is None or "@" in parts.netloc:
        return False
    return parts.scheme == "https" or (parts.scheme == "http" and _is_here(host))


def _is_here(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def shown_url(url: str) -> str:
    """Return a URL without parts that may be secret."""
    return url.partition("?")[0].partition("#")[0][:200]


def host_of(url: str) -> str:
    """Return the host name of a private URL, to show it to people."""
    return urlsplit(url).hostname or url
