"""Client addresses behind reverse proxies: `X-Forwarded-For`, trusted only from listed proxies."""

from __future__ import annotations

from collections.abc import Iterable
from ipaddress import IPv6Address, ip_address, ip_network

from rcp_kernel.errors import ConfigError

__all__ = ["Proxies"]


class Proxies:
    """The trusted proxies of one listener."""

    def __init__(self, names: Iterable[str]) -> None:
        """Parse addresses and networks.

        :raises ConfigError: one of them is invalid.
        """
        try:
            self._networks = [ip_network(name, strict=False) for name in names]
        except ValueError as error:
            raise ConfigError(
                f"[transports.asgi] proxies: {error}: use addresses or networks, such as "
                "'127.0.0.1' or '10.0.0.0/24'"
            ) from None

    def __contains__(self, address: str) -> bool:
        """Return whether an address belongs to a proxy."""
        if not self._networks:
            return False
        try:
            found = ip_address(address.partition("%")[0])
        except ValueError:
            return False
        if isinstance(found, IPv6Address) and found.ipv4_mapped is not None:
            found = found.ipv4_mapped
        return any(found in network for network in self._networks)

    def client(self, headers: Iterable[tuple[bytes, bytes]]) -> str | None:
        """Return the address that the outermost trusted proxy saw; None if there is none.

        Read from the right: the client itself may have written anything further left.
        """
        lines = [value for name, value in headers if name == b"x-forwarded-for"]
        for part in reversed(b",".join(lines).decode("latin-1").split(",")):
            text = _address(part.strip())
            if text is None:
                return None
            if text not in self:
                return text
        return None


def _address(text: str) -> str | None:
    if text.startswith("["):
        text = text[1:].partition("]")[0]
    elif text.count(":") == 1:
        text = text.partition(":")[0]
    try:
        return str(ip_address(text))
    except ValueError:
        return None
