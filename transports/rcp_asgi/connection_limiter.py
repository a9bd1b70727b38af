"""Limits on the number and rate of connections, in total and per address."""

from __future__ import annotations

from ipaddress import IPv6Address, ip_address

from rcp_asgi.config import AsgiConfig
from rcp_asgi.proxies import Proxies
from rcp_kernel.errors import QueueFull, RateLimited, RcpError

__all__ = ["ConnectionLimiter", "Seat"]

_PER_ADDRESS = 256
_RATE = 50.0
_BURST = 2.0  # s of the rate, the size of a burst


class _AddressState:
    """The connections of one address."""

    __slots__ = ("free", "near", "open", "stamp")

    def __init__(self, now: float, *, near: bool) -> None:
        self.near = near
        self.open = 0
        self.free: float | None = None
        """Remaining burst of new connections; None: all of it."""
        self.stamp = now


class Seat:
    """One connection's place within the limits."""

    __slots__ = ("_guest", "_seats", "refusal")

    def __init__(
        self, seats: ConnectionLimiter, guest: _AddressState, refusal: RcpError | None
    ) -> None:
        self._seats: ConnectionLimiter | None = seats
        self._guest = guest
        self.refusal = refusal
        """Why the connection is refused; it is kept open only to report this."""

    def leave(self) -> None:
        """Release it; idempotent."""
        if self._seats is None:
            return
        self._seats.taken -= 1
        self._guest.open -= 1
        self._seats = None


class ConnectionLimiter:
    """The connection limits of one listener. `now` is any monotonic clock, in seconds."""

    def __init__(self, config: AsgiConfig, proxies: Proxies) -> None:
        self._proxies = proxies
        self._limit = config.connections
        self._each = config.connections_per_address
        self._rate = config.connection_rate
        self._guests: dict[str, _AddressState] = {}
        self.taken = 0

    def take(self, address: str, now: float) -> Seat:
        """Count a connection; one beyond a limit gets a seat with a refusal."""
        name, near = _known_as(address)
        guest = self._guests.get(name)
        if guest is None:
            near = near or address in self._proxies
            guest = self._guests[name] = _AddressState(now, near=near)
        refusal = self._refusal(guest, now)
        self.taken += 1
        guest.open += 1
        return Seat(self, guest, refusal)

    def _refusal(self, guest: _AddressState, now: float) -> RcpError | None:
        rate = self._rate or (None if guest.near else _RATE)
        if rate is not None:
            wait = _draw(guest, rate, now)
            if wait > 0:
                return RateLimited(
                    f"more than {rate:g} connections per second from this address",
                    retry_after=wait,
                    remedy="Keep a connection open and send all requests over it.",
                )
        each = self._each or (None if guest.near else _PER_ADDRESS)
        if each is not None and guest.open >= each:
            return QueueFull(f"this address already has {each} open connections")
        if self.taken >= self._limit:
            return QueueFull(f"the gateway already has {self._limit} open connections")
        return None

    def sweep(self, now: float) -> None:
        """Remove addresses without open or recent connections."""
        gone = [n for n, g in self._guests.items() if not g.open and now - g.stamp > _BURST]
        for name in gone:
            del self._guests[name]


def _draw(guest: _AddressState, rate: float, now: float) -> float:
    """Count a new connection against the rate; return the seconds to wait if it is exceeded."""
    full = max(1.0, rate * _BURST)
    free = full if guest.free is None else min(full, guest.free + (now - guest.stamp) * rate)
    guest.stamp = now
    if free < 1:
        guest.free = free
        return (1 - free) / rate
    guest.free = free - 1
    return 0.0


def _known_as(address: str) -> tuple[str, bool]:
    """Return the key of an address, and whether it belongs to this machine.

    IPv6 addresses count by network, because one host has 2^64 of them.
    """
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address, False
    if isinstance(found, IPv6Address):
        if found.ipv4_mapped is not None:
            found = found.ipv4_mapped
        elif not found.is_loopback:
            return found.exploded[:19], False
    return str(found), found.is_loopback
