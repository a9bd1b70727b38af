"""Services of features for the rest of the gateway, found by a typed key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

__all__ = ["FeatureServices", "ServiceKey"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ServiceKey(Generic[T]):
    """The name and type of a service.

    Features list theirs in `Feature.services`; adapters call `ClientApi.service(key)`, which
    returns None if no feature provides it.
    """

    name: str


class FeatureServices:
    """The services of all features: empty until every feature has been created."""

    def __init__(self) -> None:
        self._found: dict[ServiceKey[Any], Any] = {}

    def add(self, services: Mapping[ServiceKey[Any], Any]) -> None:
        """Add the services of one feature; the first one with a key stays."""
        self._found = {**services, **self._found}

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return the service of a key; None if no feature provides it."""
        return self._found.get(key)
