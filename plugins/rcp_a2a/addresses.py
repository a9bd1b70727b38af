"""Allowed notification addresses: resolved once, checked, and used as resolved.

A name resolved a second time may point to an internal address (DNS rebinding), so the connection
uses the checked address, while `Host` and TLS keep the name.
"""

from __future__ import annotations

import asyncio
import socket
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from urllib.parse import urlsplit

import msgspec

from rcp_a2a.config import PushConfig
from rcp_kernel.errors import ConfigError
from rcp_protocol.timeouts import timeout

__all__ = ["Addresses", "Judged", "Unfit", "Unknown"]

Address = IPv4Address | IPv6Address
_LOOKUP = 5.0  # s
_LONGEST = 2048  # characters
_NAT64 = ip_network("64:ff9b::/96")  # RFC 6052: an embedded IPv4 address


class Unfit(Exception):
    """A URL that is not allowed, with the reason."""


class Unknown(Unfit):
    """The name cannot be resolved now; a later attempt may succeed."""


class Judged(msgspec.Struct, frozen=True):
    """A URL that is allowed, with its address."""

    url: str
    """The URL with the address instead of the name."""
    host: str
    """The name for `Host`."""
    name: str
    """The name for TLS."""


class Addresses:
    """Checks the URLs given by clients."""

    def __init__(self, config: PushConfig) -> None:
        """Parse the networks.

        :raises ConfigError: one is invalid.
        """
        self._http = config.http
        self._private: list[IPv4Network | IPv6Network] = []
        for text in config.private:
            try:
                self._private.append(ip_network(text))
            except ValueError as error:
                raise ConfigError(
                    f"[plugins.a2a.push] private: {error}; write a network such as 10.0.5.0/24"
                ) from None

    async def fits(self, url: str) -> bool:
        """Return whether a URL is accepted; each use checks it again."""
        try:
            await self.judge(url)
        except Unknown:
            return True
        except Unfit:
            return False
        return True

    async def judge(self, url: str) -> Judged:
        """Resolve a URL's name; return how to call it.

        :raises Unfit: the URL is not allowed.
        :raises Unknown: its name cannot be resolved now.
        """
        if len(url) > _LONGEST:
            raise Unfit("the URL is too long")
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise Unfit("the URL is malformed") from error
        if parts.scheme != "https" and not (parts.scheme == "http" and self._http):
            raise Unfit("the URL is not https")
        if not parts.hostname or parts.username is not None or parts.password is not None:
            raise Unfit("the URL has no host, or contains a user name")
        address = await self._look_up(parts.hostname, port or _default(parts.scheme))
        place = f"[{address}]" if address.version == 6 else str(address)
        netloc = place if port is None else f"{place}:{port}"
        pinned = parts._replace(netloc=netloc, fragment="").geturl()
        return Judged(pinned, parts.netloc, parts.hostname)

    async def _look_up(self, name: str, port: int) -> Address:
        loop = asyncio.get_running_loop()
        try:
            async with timeout(_LOOKUP):
                found = await loop.getaddrinfo(name, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError, TimeoutError) as error:
            raise Unknown("the URL's host cannot be resolved") from error
        addresses = [ip_address(str(info[4][0]).partition("%")[0]) for info in found]
        # All addresses: a name could have both a public and a private one.
        if not addresses or not all(map(self._fit, addresses)):
            raise Unfit("the URL's address is not allowed")
        return addresses[0]

    def _fit(self, address: Address) -> bool:
        if isinstance(address, IPv6Address):
            if address.ipv4_mapped is not None:
                return self._fit(address.ipv4_mapped)
            if address.sixtofour is not None:
                return self._fit(address.sixtofour)
            if address in _NAT64:
                return self._fit(IPv4Address(int(address) & 0xFFFFFFFF))
        if any(address in network for network in self._private):
            return True
        return address.is_global and not address.is_multicast and not address.is_reserved


def _default(scheme: str) -> int:
    return 443 if scheme == "https" else 80
