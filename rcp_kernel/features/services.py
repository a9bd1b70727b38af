"""Named services: what one feature offers to the rest of the gateway, found by a typed key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = ["ServiceKey", "ServiceLookup"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ServiceKey(Generic[T]):
    """The name of a service, and its type.

    A feature lists what it offers in `Feature.services`; adapters ask `ClientApi.service(key)`, which
    returns None where no feature offers it.
    """

    name: str


class ServiceLookup(Protocol):
    """Finds what features offer."""

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return the service of a key; None where no feature offers it."""
        ...
