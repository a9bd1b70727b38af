"""Services of features for the rest of the gateway, found by a typed key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = ["FeatureServices", "ServiceKey", "ServiceLookup"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ServiceKey(Generic[T]):
    """The name and type of a service.

    Features list theirs in `Feature.services`; adapters call `ClientApi.service(key)`, which
    returns None if no feature provides it.
    """

    name: str


class ServiceLookup(Protocol):
    """Finds the services of features."""

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return the service of a key; None if no feature provides it."""
        ...


class FeatureServices:
    """The services of features, for features: there are none until all features have been made."""

    def __init__(self) -> None:
        self._found: ServiceLookup | None = None

    def set_lookup(self, found: ServiceLookup) -> None:
        """Set the features that have been made."""
        self._found = found

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return the service of a key; None if no feature provides it."""
        return None if self._found is None else self._found.service(key)
