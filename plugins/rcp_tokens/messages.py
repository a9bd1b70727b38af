"""The data types of keys."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rcp_kernel.types import Time

__all__ = ["ListedKey", "Revocation"]


class ListedKey(Struct, frozen=True, kw_only=True):
    """One key as it is listed: never the key, nor its hash."""

    key: str
    """Its id."""
    principal: str
    grants: dict[str, list[str]]
    """Roles by tenant."""
    state: Literal["good", "expired", "revoked"]
    created: Time
    expires: Time | None
    revoked: Time | None


class Revocation(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which key to revoke."""

    revoke: Annotated[str, Meta(min_length=1, max_length=64)]
    """Its id."""
