"""The key expressions of a fleet.

`rcp/<tenant>/<gateway>/alive` is a token of a robot's gateway; `…/link/<hub>/<link>` is a token of a
hub for one of its links with it; `<link>` ends in `.json` or `.cbor` if its messages are not MessagePack. On a link, `…/in/<hub>/<link>` carries what the hub says, and
`…/out/<hub>/<link>` what the gateway says. Access control can thus be by prefix and by hub.
"""

from __future__ import annotations

from typing import NamedTuple

from rcp_kernel.values import Encoding

__all__ = ["LinkKeys", "alive", "encoding_of", "links_of", "part", "revoked"]

_ROOT = "rcp"


class LinkKeys(NamedTuple):
    """The keys of one link between a hub and a gateway."""

    token: str
    up: str
    """From the hub to the gateway."""
    down: str
    """From the gateway to the hub."""

    @classmethod
    def of(cls, tenant: str, gateway: str, hub: str, link: str) -> LinkKeys:
        """Name the keys of a link."""
        base, tail = f"{_ROOT}/{tenant}/{gateway}", f"{hub}/{link}"
        return cls(f"{base}/link/{tail}", f"{base}/in/{tail}", f"{base}/out/{tail}")


def alive(tenant: str, gateway: str = "*") -> str:
    """Name the token of a gateway, or of all of a tenant."""
    return f"{_ROOT}/{tenant}/{gateway}/alive"


def revoked(tenant: str) -> str:
    """Name where the list of revoked hubs is published."""
    return f"{_ROOT}/{tenant}/revoked"


def links_of(tenant: str, gateway: str) -> LinkKeys:
    """Name the keys of all links of a gateway."""
    return LinkKeys.of(tenant, gateway, "*", "*")


def encoding_of(link: str) -> Encoding:
    """Return the encoding of the messages on a link, MessagePack if its name says none."""
    name = link.partition(".")[2]
    return next((one for one in Encoding if one.value == name), Encoding.MSGPACK)


def part(key: object, index: int) -> str:
    """Return one chunk of a key."""
    return str(key).split("/")[index]
