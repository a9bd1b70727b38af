"""The table `[features.logins]`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

__all__ = ["LoginsConfig"]


class LoginsConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[features.logins]`."""

    lifetime: Annotated[float, Meta(ge=60, le=2_592_000)] = 43_200.0
    """Seconds after which a login ends, however much it is used."""
    idle: Annotated[float, Meta(ge=60, le=2_592_000)] = 7_200.0
    """Seconds after which a login ends that has neither an open page nor a request."""
    per_person: Annotated[int, Meta(ge=1, le=1_000)] = 20
    """Maximum number of logins of one principal; one more ends the one that was used least recently."""
    most: Annotated[int, Meta(ge=1, le=100_000)] = 5_000
    """Maximum number of logins of all."""
