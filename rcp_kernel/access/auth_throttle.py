"""Throttling of failed logins per address.

Other clients behind the same address (a proxy, a NAT) are not locked out: valid keys are found by
their hash before this check, and so are previously valid ones. Signed tokens, which cannot be
guessed, are still verified, at a rate that costs the gateway next to nothing. All others must wait
until the allowance of the address has recovered.
"""

from __future__ import annotations

from collections.abc import Callable
from ipaddress import IPv6Address, ip_address

from rcp_kernel.errors import RateLimited

__all__ = ["AuthThrottle"]

_ADDRESSES = 20_000
_GOOD = 20_000  # credentials
_PERIOD = 60.0  # s in which the whole allowance recovers
_SIGNED = 0.01  # s between two signatures from an address that has used up its allowance


class AuthThrottle:
    """Counts failures by address; `clock` is monotonic, in seconds."""

    def __init__(self, allowance: int, clock: Callable[[], float]) -> None:
        self.allowance = allowance
        self._clock = clock
        self._spent: dict[str, tuple[float, float]] = {}
        """Number of failures not forgotten yet, and when it was computed."""
        self._good: dict[str, None] = {}
        self._next: dict[str, float] = {}
        """When the next signature of a network may be verified."""

    def __len__(self) -> int:
        """Count the networks that it remembers."""
        return len(self._spent)

    def check(self, address: str | None, digest: str, *, signed: bool = False) -> None:
        """Check that a credential may be verified; `signed` means that it cannot be guessed.

        :raises RateLimited: too many failures from this address; see `retry_after`.
        """
        if address is None or not self._spent or digest in self._good:
            return
        network = _network(address)
        over = self._left(network) - self.allowance + 1
        if over <= 0:
            return
        wait = over * _PERIOD / self.allowance
        if signed:
            wait = self._next.get(network, 0.0) - self._clock()
            if wait <= 0:
                return
        raise RateLimited(
            "too many failed logins from this address",
            retry_after=max(round(wait, 3), 0.001),
            remedy="Wait `retry_after` seconds, then send a valid token.",
        )

    def failed(self, address: str | None, digest: str) -> None:
        """Count a failure."""
        self._good.pop(digest, None)
        if address is None:
            return
        network = _network(address)
        spent = min(self._left(network) + 1, self.allowance)  # however many arrived together
        self._spent.pop(network, None)
        if len(self._spent) >= _ADDRESSES:
            self._forget(next(iter(self._spent)))
        moment = self._clock()
        self._spent[network] = (spent, moment)
        self._next[network] = moment + _SIGNED

    def forgive(self, address: str | None) -> None:
        """Subtract one failure."""
        network = None if address is None else _network(address)
        if network is None or network not in self._spent:
            return
        left = self._left(network) - 1
        if left > 0:
            self._spent[network] = (left, self._clock())
        elif network in self._spent:
            self._forget(network)

    def succeeded(self, digest: str) -> None:
        """Remember that a credential is valid."""
        if digest not in self._good:
            if len(self._good) >= _GOOD:
                del self._good[next(iter(self._good))]
            self._good[digest] = None

    def _left(self, network: str) -> float:
        known = self._spent.get(network)
        if known is None:
            return 0.0
        spent, then = known
        left = spent - (self._clock() - then) * self.allowance / _PERIOD
        if left <= 0:
            self._forget(network)
            return 0.0
        return left

    def _forget(self, network: str) -> None:
        del self._spent[network]
        self._next.pop(network, None)


def _network(address: str) -> str:
    """Return the part of an address that one party has: an IPv4 address, or an IPv6 /64."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, IPv6Address):
        mapped = found.ipv4_mapped
        return str(mapped) if mapped else found.exploded[:19]
    return address
