"""Connection settings of a client."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from ssl import SSLContext

from rcp_client.address import Address
from rcp_client.carrier import Dial
from rcp_client.messages import Notice
from rcp_protocol.values import Encoding

__all__ = ["MARGIN", "Settings"]

MARGIN = 2.0  # s beyond the deadline to wait for the gateway's own reply


@dataclass(frozen=True, slots=True)
class Settings:
    """Connection settings of a client; times in s."""

    address: Address
    others: tuple[Address, ...] = ()
    """Further addresses of the gateway, or of other hubs of its fleet; each is tried in turn."""
    token: str | Callable[[], str] | None = None
    """A function returns a new one for each `hello`, and before the last one expires."""
    tenant: str | None = None
    encoding: Encoding = Encoding.MSGPACK
    deadline: float = 10.0
    """For requests without their own deadline."""
    connect_timeout: float = 5.0
    """For one connection attempt."""
    patience: float | None = 120.0
    """For reconnecting; None never gives up."""
    first_pause: float = 0.1
    """Before the second attempt to reconnect; doubles up to `longest_pause`."""
    longest_pause: float = 5.0
    heartbeat: float = 5.0
    """Silence before a ping, and again before the connection counts as dead."""
    client: str = "rcp-client/python"
    ssl: SSLContext | None = None
    on_notice: Callable[[Notice], None] | None = None
    persistent: bool = False
    """Whether a refusal of a session that once began is tried again, as a lost connection is; the
    notice `refused` tells of it."""
    dial: Dial | None = None
    """Opens connections that are no WebSockets; the token then goes into `hello`."""

    def proof(self) -> str | None:
        """Return the token to send now."""
        return self.token() if callable(self.token) else self.token
