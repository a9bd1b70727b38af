"""The table `[features.places]`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.errors import ConfigError, InvalidValue
from rcp_places.messages import Name, Shape, check_shape

__all__ = ["GivenPlace", "PlacesConfig", "check"]


class GivenPlace(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A place of the configuration."""

    tenant: str = "*"
    """The tenant whose place it is; default: that of all."""


class PlacesConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[features.places]`."""

    most: Annotated[int, Meta(ge=1, le=10_000)] = 500
    """Maximum number of places that people can add to one tenant, and of those of all tenants."""
    given: dict[Name, GivenPlace] = {}
    """Places that only the configuration changes, by name."""


def check(config: PlacesConfig, _: object) -> None:
    """Check the places.

    :raises ConfigError: names the one that has no position.
    """
    for name, place in config.given.items():
        try:
            check_shape(place)
        except InvalidValue as error:
            raise ConfigError(f"[features.places.given.{name}]: {error.message}") from None
