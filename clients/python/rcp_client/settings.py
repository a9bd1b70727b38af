"""How a client connects and how patient it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from ssl import SSLContext

from rcp_client.address import Address
from rcp_client.messages import Notice
from rcp_protocol.values import Encoding

__all__ = ["MARGIN", "Settings"]

MARGIN = 2.0  # s that the gateway's own answer is given beyond the deadline


@dataclass(frozen=True, slots=True)
class Settings:
    """How a client connects and how patient it is."""

    address: Address
    token: str | None = None
    tenant: str | None = None
    encoding: Encoding = Encoding.MSGPACK
    deadline: float = 10.0
    """Seconds for a request that names no deadline."""
    connect_timeout: float = 5.0
    """Seconds for one attempt."""
    patience: float | None = 120.0
    """Seconds to try to come back; None never gives up."""
    first_pause: float = 0.1
    """Seconds before the second attempt to come back; doubles up to `longest_pause`."""
    longest_pause: float = 5.0
    heartbeat: float = 5.0
    """Seconds of silence before a ping, and again before the connection counts as dead."""
    client: str = "rcp-client/python"
    ssl: SSLContext | None = None
    on_notice: Callable[[Notice], None] | None = None
