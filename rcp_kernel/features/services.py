"""Services of features for the rest of the gateway, found by a typed key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = ["ServiceKey", "ServiceLookup"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ServiceKey(Generic[T]):
    """The name and type of a service.

    Features list theirs in `Feature.services`; adapters call `ClientApi.service(key)`, which
    returns
    None if no feature provides it.
    """

    name: str


class ServiceLookup(Protocol):
    """Finds the services of features."""

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return the service of a key; None if no feature provides it."""
        ...
